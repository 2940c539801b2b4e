"""The training tasks of the networks of `kit1000.perception`, with their examples."""
