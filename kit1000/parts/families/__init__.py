"""The part families: one file, one drawing. `kit1000/parts/catalog.py` lists them all."""
