"""Reading a dataset folder: tables, recordings, splits, items for a network and a cache of volumes."""
