#!/usr/bin/env bash
# Trains the networks that restore noisy depth images (docs/methods/restoration.md).
#
#     bash bench/recipes/restoration.sh [DATA]
#
# Run it in the root of a checkout, where `python` has kit1000[learn]. DATA is a dataset with ground truth, by default
# data/kit1000. `ship` replaces the weights in kit1000/weights. The same command resumes an interrupted recipe. The
# released weights made all but their last run on the sensors of data 1.0.0: repeated, these runs give others.
set -euo pipefail

data="${1:-data/kit1000}"
commit="$(git rev-parse HEAD)"

# First run of the network with masks: 3500 steps on 1500 views, new weights.
python -m baselines train restoration --preset pretraining --data "$data" --out runs/restoration-first

# Second run: 5000 steps on 3000 other views, from the best weights of the first.
python -m baselines train restoration --data "$data" --out runs/restoration \
    --start runs/restoration-first/best.safetensors

# Third run: 3995 steps of 64 examples on 30,000 other views, from the best weights of the second; on a GPU.
python -m baselines train restoration --preset measured --data "$data" --out runs/restoration-third \
    --start runs/restoration/best.safetensors --steps 3995
python -m baselines ship runs/restoration-third --commit "$commit" --precision float16

# The network without masks, for segmentation, first run: 3500 steps on 1500 views, new weights.
python -m baselines train restoration-unmasked --data "$data" --out runs/restoration-unmasked

# Second run: 3995 steps of 64 examples on 30,000 other views; on a GPU.
python -m baselines train restoration-unmasked --preset measured --data "$data" --out runs/restoration-unmasked-second \
    --start runs/restoration-unmasked/best.safetensors --steps 3995
python -m baselines ship runs/restoration-unmasked-second --commit "$commit" --precision float16

# The network that fills holes of a scanner, first run: 3000 steps on 2500 views, from the released restoration.
python -m baselines train hole-filling --preset pretraining --data "$data" --out runs/hole-filling-first \
    --start kit1000/weights/restoration.safetensors

# Second run: 4000 steps on 2000 other views.
python -m baselines train hole-filling --data "$data" --out runs/hole-filling \
    --start runs/hole-filling-first/best.safetensors
python -m baselines ship runs/hole-filling --commit "$commit" --precision float16
