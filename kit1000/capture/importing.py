"""The import from the first file to the folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from kit1000.capture.camera_files import read_intrinsics
from kit1000.capture.depth_frames import DepthFrame
from kit1000.capture.frame_selection import Selection
from kit1000.capture.frame_sources import read_groups
from kit1000.capture.intrinsics import Intrinsics
from kit1000.capture.own_folder import LICENCE, write_own_folder
from kit1000.capture.own_scene import OwnScene, Wanted, frame_intrinsics, image_of_frames, own_scene
from kit1000.capture.own_world import read_pose
from kit1000.capture.scene_report import check_sides, check_size, report
from kit1000.capture.seen_bodies import MOST_BODIES
from kit1000.capture.table_search import Table, find_table
from kit1000.errors import InputError
from kit1000.files import check_output

CLEARANCES = (0.05, 100.0)  # [mm]


@dataclass(frozen=True)
class Import:
    """What to import, and how."""

    sources: tuple[Path, ...]
    out: Path
    intrinsics: tuple[str, ...] = ()
    """A file, or fx fy cx cy; empty: those of the recording."""
    selection: Selection = field(default_factory=Selection)
    wanted: Wanted = field(default_factory=Wanted)
    poses: tuple[Path, ...] = ()
    """JSON files of hand-eye poses: one for all images, or one for each; empty: the bodies tell."""
    empty_table: Path | None = None
    clearance_mm: float | None = None
    check_mm: tuple[float, ...] = ()
    licence: str = LICENCE
    one_scene: bool = False
    """Whether the images show the same bodies, each from its own pose."""


def import_scenes(asked: Import) -> list[str]:
    """Import, and return the lines of the report. Raises InputError, and writes nothing, where a source is refused."""
    _check(asked)
    clearance = None if asked.clearance_mm is None else 1e-3 * asked.clearance_mm
    scenes = imported_scenes(asked)
    lines = [line for scene in scenes for line in report(scene, clearance)]
    if asked.check_mm:
        lines.append(check_size(scenes, [1e-3 * side for side in asked.check_mm]))
    if asked.one_scene:
        lines.append(f"  {len(scenes)} images of one scene: methods of registration answer by all of them")
    write_own_folder(asked.out, scenes, clearance, asked.licence, asked.one_scene)
    return lines


def default_folder(sources: Sequence[Path]) -> Path:
    """The folder beside the first source that an import writes where none is named."""
    if not sources:
        raise InputError("SOURCE: expected a depth image or a recording")
    return sources[0].with_name(f"{sources[0].stem}-scene")


def imported_scenes(asked: Import) -> list[OwnScene]:
    """The scenes of an import, before they are written."""
    groups = read_groups(asked.sources, asked.selection)
    known = [_intrinsics(asked, frames) for frames in groups]
    wanted = [replace(asked.wanted, world_from_camera=pose) for pose in _poses(asked, len(groups))]
    empty = _empty_table(asked)
    return [own_scene(*each, empty) for each in zip(groups, known, wanted, strict=True)]


def _poses(asked: Import, images: int) -> Sequence[Path | None]:
    """The file of the pose of each image; raises InputError for another number of files."""
    given = len(asked.poses)
    if asked.one_scene and not 1 < given == images:
        raise InputError(
            f"--one-scene: expected two images or more, and a pose of each, got {images} and {given} by "
            "--world-from-camera FILE FILE ..."
        )
    if given not in (0, 1, images):
        raise InputError(f"--world-from-camera: expected one file, or one for each of {images} images, got {given}")
    return asked.poses if given == images else [asked.poses[0] if given else None] * images


def _check(asked: Import) -> None:
    """Raise InputError for options that cannot be, before anything is read."""
    if not asked.sources:
        raise InputError("SOURCE: expected a depth image or a recording")
    check_output(asked.out)
    if asked.selection.frames < 1 or asked.selection.first < 0:
        raise InputError("--frames: expected 1 or more, --first: 0 or more")
    low, high = CLEARANCES
    if asked.clearance_mm is not None and not low <= asked.clearance_mm <= high:
        raise InputError(f"--clearance-mm: expected {low:g} to {high:g}, got {asked.clearance_mm:g}")
    for name, value in (("--depth-scale", asked.wanted.depth_scale), ("--baseline-mm", asked.wanted.baseline)):
        if value is not None and not 0 < value <= 1:
            raise InputError(f"{name}: expected above 0 and up to 1 m, got {value:g} m")
    if not 1 <= asked.wanted.kit <= MOST_BODIES:
        raise InputError(f"--kit {asked.wanted.kit}: expected the number of a body, from 1 to {MOST_BODIES}")
    if asked.check_mm:
        check_sides([1e-3 * side for side in asked.check_mm])
    for path in asked.poses:
        read_pose(path)


def _intrinsics(asked: Import, frames: Sequence[DepthFrame]) -> Intrinsics | None:
    """The given intrinsics, for the image of some frames."""
    if not asked.intrinsics:
        return None
    return read_intrinsics(asked.intrinsics, Path(frames[0].source))


def _empty_table(asked: Import) -> Table | None:
    """The table of the image without bodies, where there is one."""
    if asked.empty_table is None:
        return None
    frames = [frame for group in read_groups([asked.empty_table], asked.selection) for frame in group]
    known = frame_intrinsics(frames[0], _intrinsics(asked, frames))
    return find_table(image_of_frames(frames, known, asked.wanted.depth_scale), str(asked.empty_table))
