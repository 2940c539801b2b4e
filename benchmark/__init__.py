"""The benchmark of KIT1000: a protocol, scores with intervals, robustness curves, and the pages of the leaderboard.

It reads a dataset and submissions and writes files; it runs no method. `python -m benchmark --help` lists the commands.
"""
