#!/usr/bin/env bash
# Trains the networks that complete parts and kits (docs/methods/completion.md).
#
#     bash bench/recipes/completion.sh [DATA]
#
# Run it in the root of a checkout, where `python` has kit1000[learn]. DATA is a dataset with ground truth, by default
# data/kit1000. The examples of kits are restored by kit1000/weights/restoration: run restoration.sh first to replace
# it. `ship` replaces the weights in kit1000/weights. Sampled parts are kept in the user's cache, in drawn-parts. The
# released weights made all noisy runs but the last one of completion-d415 on the sensors of data 1.0.0: repeated, these
# runs give others.
set -euo pipefail

data="${1:-data/kit1000}"
commit="$(git rev-parse HEAD)"
weights=kit1000/weights

# Parts, first run: 5600 steps on 20,000 parts (seed 2026), 35 % of the views by the d415, new weights. The learning
# rate of the released run fell as for 6800 steps up to step 2750, and as for 5600 afterwards.
python -m baselines train completion --preset pretraining --data "$data" --out runs/first
python -m baselines ship runs/first --commit "$commit" --precision float16

# Second run: 6500 steps, other views of these parts, from the weights of the first.
python -m baselines train completion --preset pretraining --data "$data" --out runs/second \
    --start "$weights/completion.safetensors" --steps 6500 --learning-rate 3e-3 --seed 1
python -m baselines ship runs/second --commit "$commit" --precision float16

# Noisy images, first run: 4000 steps on 20,000 other parts (seed 2027), all by the d415, from the second run.
python -m baselines train completion-d415 --data "$data" --out runs/d415-first --start "$weights/completion.safetensors"
python -m baselines ship runs/d415-first --commit "$commit" --precision float16

# Noisy images, second run: 5500 steps, other views of the same parts.
python -m baselines train completion-d415 --data "$data" --out runs/d415 \
    --start "$weights/completion-d415.safetensors" --steps 5500 --learning-rate 3e-3 --seed 3
python -m baselines ship runs/d415 --commit "$commit" --precision float16

# Noisy images, third run: 9269 steps of 64 views of 20,000 other parts (seed 2051), from the second run, on a GPU; the
# released completion-d415.
python -m baselines train completion-d415 --preset measured --data "$data" --out runs/d415-third \
    --start "$weights/completion-d415.safetensors" --steps 9269
python -m baselines ship runs/d415-third --commit "$commit" --precision float16

# Parts, third run: 6500 steps on the parts of seed 2027 in ideal depth alone, from the second run; the released
# completion.
python -m baselines train completion --data "$data" --out runs/third --start "$weights/completion.safetensors" --seed 4
python -m baselines ship runs/third --commit "$commit" --precision int8

# Kits, first run: 3000 steps on 12,000 views, three quarters of them with one of 3000 newly cut kits, new weights.
python -m baselines train kit-completion --preset pretraining --data "$data" --out runs/kits-first
python -m baselines ship runs/kits-first --commit "$commit"

# Kits, second run: 2500 steps on 10,000 views, a quarter of them with one of 600 newly cut kits.
python -m baselines train kit-completion --preset pretraining-2 --data "$data" --out runs/kits-second \
    --start "$weights/kit-completion.safetensors"
python -m baselines ship runs/kits-second --commit "$commit"

# Kits, third run: 4000 steps on 14,000 views, half with one of 3000 newly cut kits, three quarters with stretched ones;
# the released kit-completion.
python -m baselines train kit-completion --data "$data" --out runs/kits --start "$weights/kit-completion.safetensors"
python -m baselines ship runs/kits --commit "$commit" --precision float16
