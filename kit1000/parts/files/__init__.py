"""Mesh files of any origin as parts: read and repaired, or refused with one line."""
