"""SnapNet: two networks that correct a guess, one of the position by cross-correlation, one of the rotation by points.

After "Scene Editing as Teleoperation" (IROS 2022, arXiv 2110.04450).
"""

from baselines.snapnet.method import SnapNet

__all__ = ["SnapNet"]
