"""The network that completes a part from one depth image."""
