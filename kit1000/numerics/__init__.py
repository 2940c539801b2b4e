"""Arithmetic with the same bits on every processor, see the conventions of the documentation; compiled loops."""
