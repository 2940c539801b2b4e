"""The leaderboard as static pages: a board of all methods, a page for each, no server and nothing from elsewhere.

`submissions/<name>/{manifest.toml,scores.json}` is all they are made of; with the dataset at hand, single cases are
drawn too. The same files give the same pages, byte for byte.
"""

from benchmark.pages.site import build

__all__ = ["build"]
