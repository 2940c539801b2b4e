"""The network that places a fit in its plate: `channels` (what it reads), `network`, `placer` (with its weights)."""
