"""What an import is asked for: the images, and what the user says about them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from kit1000.sim.sensors import Stream

LICENCE = "the user's own"


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """The options of an import, by the names that they have on the command line."""

    sources: tuple[Path, ...]
    out: Path
    intrinsics: tuple[str, ...] = ()
    """A file, or fx fy cx cy; empty: those of the recording."""
    depth_scale: float | None = None
    """[m] that 1 in an image stands for; None: as the files or the name of the camera say."""
    topic: str | None = None
    """Topic of the depth images in a recording; None: the only one."""
    frames: int = 1
    """Number of successive frames of which an image is the median."""
    first: int = 0
    """Index of the first frame of a recording."""
    device: str = ""
    """Name of the camera; empty: as the files say. It tells a structured-light scanner from a stereo camera."""
    baseline_mm: float | None = None
    """Distance between the camera's imagers; None: by its name."""
    stream: Stream | None = None
    """None: as the files say, else raw of a scanner and aligned of other cameras."""
    kit: int = 1
    """Number of the body that is the kit, the largest first, from 1."""
    kit_size: tuple[float, float, float] | None = None
    """[m] level sides and height of the kit: the body nearest to them is the kit, instead of the largest."""
    world_from_camera: tuple[Path, ...] = ()
    """Files of hand-eye poses: one for all images, or one for each; empty: the world follows from the bodies."""
    clearance_mm: float | None = None
    """Gap between a part and the walls of its cavity; None: not known."""
    networks: bool = False
    """Whether the networks of segmentation cut the masks back."""
    check: tuple[float, ...] = ()
    """Sides [mm] of a box in view; empty: sizes are not checked."""
    licence: str = LICENCE
    """Licence of the images, for the recordings."""
    one_scene: bool = False
    """Whether the images show the same bodies, each from its own pose."""
