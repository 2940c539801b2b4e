"""Networks that complete what a depth image hides: of the part (`parts`), and of the kits (`kits`)."""
