"""The shapes that registration compares: cavities, envelopes, swept slices, faces, height maps."""
