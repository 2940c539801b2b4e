"""What an import is asked for: the images, and what the user says about them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from kit1000.sim.sensors import Stream

LICENCE = "the user's own"


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """The options of an import, by the names that they have on the command line, whose help says what each means."""

    sources: tuple[Path, ...]
    out: Path
    intrinsics: tuple[str, ...] = ()
    depth_scale: float | None = None  # [m]
    topic: str | None = None
    frames: int = 1
    first: int = 0
    device: str = ""
    baseline_mm: float | None = None
    stream: Stream | None = None
    kit: int = 1
    kit_size: tuple[float, float, float] | None = None  # [m] sides and height: the body nearest to them is the kit
    world_from_camera: tuple[Path, ...] = ()
    clearance_mm: float | None = None
    networks: bool = False  # whether the networks of segmentation cut the masks back
    check: tuple[float, ...] = ()  # [mm]
    licence: str = LICENCE
    one_scene: bool = False
