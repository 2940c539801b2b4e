#!/usr/bin/env bash
# Trains the seven networks of SnapNet, preset small (docs/methods/snapnet.md).
#
#     bash bench/recipes/snapnet.sh [DATA]
#
# Run it in the root of a checkout, where `python` has kit1000[learn]. DATA is a dataset with ground truth, by default
# data/kit1000. The released networks made their first runs on data version 0.2.1 and the further ones on 1.0.0.
# Completed parts and kits come from kit1000/weights: run completion.sh first to replace them. `ship` replaces the
# weights in baselines/weights. The same command resumes an interrupted recipe.
set -euo pipefail

data="${1:-data/kit1000}"
commit="$(git rev-parse HEAD)"

# First runs, new weights. True volumes: 4000 steps for the position, 3000 for the rotation, of which the released
# network made 2000.
python -m baselines train snapnet-gtvol-position --data "$data" --out runs/gtvol-position-first --steps 4000
python -m baselines train snapnet-gtvol-rotation --data "$data" --out runs/gtvol-rotation-first --steps 3000

# One depth image, completed by rules: 4000 steps for the position, 3000 for the rotation.
python -m baselines train snapnet-partialvol-position --data "$data" --out runs/partialvol-position-first --steps 4000
python -m baselines train snapnet-partialvol-rotation --data "$data" --out runs/partialvol-rotation-first --steps 3000

# True volumes, further runs from the best weights: 1200 and 1000 steps; the released snapnet-gtvol-*.
python -m baselines train snapnet-gtvol-position --data "$data" --out runs/gtvol-position \
    --start runs/gtvol-position-first/best.safetensors --steps 1200 --learning-rate 6e-4
python -m baselines train snapnet-gtvol-rotation --data "$data" --out runs/gtvol-rotation \
    --start runs/gtvol-rotation-first/best.safetensors --steps 1000 --learning-rate 5e-4
python -m baselines ship runs/gtvol-position --commit "$commit"
python -m baselines ship runs/gtvol-rotation --commit "$commit"

# One depth image, further runs: 800 and 1200 steps; the released snapnet-partialvol-*.
python -m baselines train snapnet-partialvol-position --data "$data" --out runs/partialvol-position \
    --start runs/partialvol-position-first/best.safetensors --steps 800 --learning-rate 6e-4
python -m baselines train snapnet-partialvol-rotation --data "$data" --out runs/partialvol-rotation \
    --start runs/partialvol-rotation-first/best.safetensors --steps 1200 --learning-rate 6e-4
python -m baselines ship runs/partialvol-position --commit "$commit"
python -m baselines ship runs/partialvol-rotation --commit "$commit"

# Parts completed by a network, from the first runs of partial volumes: 1200 and 2000 steps; the released
# snapnet-position and snapnet-rotation.
python -m baselines train snapnet-position --data "$data" --out runs/position \
    --start runs/partialvol-position-first/best.safetensors --steps 1200 --learning-rate 6e-4
python -m baselines train snapnet-rotation --data "$data" --out runs/rotation \
    --start runs/partialvol-rotation-first/best.safetensors --steps 2000 --learning-rate 6e-4
python -m baselines ship runs/position --commit "$commit"
python -m baselines ship runs/rotation --commit "$commit"

# Parts and kits completed by networks, from the rotation network of completed parts: 2000 steps; the released
# snapnet-kits-rotation.
python -m baselines train snapnet-kits-rotation --data "$data" --out runs/kits-rotation \
    --start runs/rotation/best.safetensors --steps 2000 --learning-rate 8e-4
python -m baselines ship runs/kits-rotation --commit "$commit"
