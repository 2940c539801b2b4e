"""What one depth image shows of a part and of kits, and what it hides as far as that follows from how they are made."""

from baselines.completion.kits import SeenKits
from baselines.completion.part import AROUND, SeenPart

__all__ = ["AROUND", "SeenKits", "SeenPart"]
