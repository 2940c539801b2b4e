"""What a dataset says of itself to people and to tools: figures, data card, Croissant."""
