"""The leaderboard as static pages: a board of all methods and a page for each, without a server or external files.

They are made of `submissions/<name>/{manifest.toml,scores.json}` alone; with the dataset, single queries are drawn too.
The same files give the same pages, byte for byte.
"""

from benchmark.pages.site import build

__all__ = ["build"]
