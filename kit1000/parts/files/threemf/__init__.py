"""Reading 3MF files: the archive, its models, what slicers say about their volumes, and the placed build."""
