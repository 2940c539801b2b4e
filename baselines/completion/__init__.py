"""Solid volumes of a part and of kits from one depth image: observed surfaces, completed by how parts and kits are."""

from baselines.completion.kits import ObservedKits
from baselines.completion.part import TABLE_MARGIN, ObservedPart

__all__ = ["TABLE_MARGIN", "ObservedKits", "ObservedPart"]
