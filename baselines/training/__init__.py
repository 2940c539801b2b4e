"""One training loop for every network: deterministic examples, checkpoints, weights without pickles."""
