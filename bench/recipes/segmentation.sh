#!/usr/bin/env bash
# Trains the network that separates parts in noisy depth images (docs/methods/segmentation.md).
#
#     bash bench/recipes/segmentation.sh [DATA]
#
# Run it in the root of a checkout, where `python` has kit1000[learn]. DATA is a dataset with ground truth, by default
# data/kit1000. The examples are restored by kit1000/weights/restoration-unmasked: run restoration.sh first to replace
# it. `ship` replaces the weights in kit1000/weights. The released weights made all but their last run on the sensors
# of data 1.0.0: repeated, these runs give others.
set -euo pipefail

data="${1:-data/kit1000}"
commit="$(git rev-parse HEAD)"
weights=kit1000/weights

# First run: 3500 steps on 8 crops of each of 1500 views, new weights.
python -m baselines train segmentation --preset pretraining --data "$data" --out runs/segmentation-first
python -m baselines ship runs/segmentation-first --commit "$commit" --precision float16

# Second run: 4500 steps on 2500 other views, from the weights of the first.
python -m baselines train segmentation --data "$data" --out runs/segmentation \
    --start "$weights/segmentation.safetensors"
python -m baselines ship runs/segmentation --commit "$commit" --precision float16

# Third run: 10,924 steps of 64 crops from 30,000 other views, from the weights of the second; on a GPU.
python -m baselines train segmentation --preset measured --data "$data" --out runs/segmentation-third \
    --start "$weights/segmentation.safetensors" --steps 10924
python -m baselines ship runs/segmentation-third --commit "$commit" --precision float16

# Fourth run: 1500 steps on 1500 other views, from the weights of the third. Before it crops were about random pixels of
# parts, but for one in twenty; since then they show more of what is mistaken (`SHARES`). The released weights are those
# of step 500: later ones tell the crops of the run better, but not those of other scenes.
python -m baselines train segmentation --preset hard --data "$data" --out runs/segmentation-fourth \
    --start "$weights/segmentation.safetensors"
python -m baselines ship runs/segmentation-fourth --commit "$commit" --precision float16
