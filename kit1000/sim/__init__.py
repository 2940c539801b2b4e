"""Scenes of kits and parts: laid out, settled, seen by cameras, and drawn for people to look at."""
