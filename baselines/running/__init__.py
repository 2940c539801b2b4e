"""Training networks by name, and predicting submissions again."""
