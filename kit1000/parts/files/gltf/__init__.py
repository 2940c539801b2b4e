"""Reading glTF 2.0: the file with its buffers, typed accessors, required extensions, and the placed scene."""
