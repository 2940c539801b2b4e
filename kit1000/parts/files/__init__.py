"""Mesh files of other people made into parts: read, mended, or refused with one line."""
