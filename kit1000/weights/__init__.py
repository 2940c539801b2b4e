"""The trained networks that perception and registration load: NAME.safetensors with NAME.json each."""

from pathlib import Path

WEIGHTS = Path(__file__).parent
"""Their folder."""
