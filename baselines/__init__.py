"""The reference methods of KIT1000: each reads a dataset and writes a submission; none scores itself."""
