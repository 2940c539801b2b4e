"""Generation of a dataset: the plan, then parts and kits, assemblies, scenes with their queries, and the summary."""
