"""Simulated scenes of kits and parts: layout, rigid-body settling, cameras, rendering, depth sensors."""
