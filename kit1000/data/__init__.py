"""The dataset: its plan, how it is built and resumed, its files and how they are read."""
