"""Kits: a plate with the cavity of one part, the poses that seat it, and assemblies of several tilted kits."""
