"""The network that completes what an image hides of the kits."""
