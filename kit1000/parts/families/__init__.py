"""The part families: one file, one drawing. `kit1000/parts/family_catalog.py` lists them all."""
