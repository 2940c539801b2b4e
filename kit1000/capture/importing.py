"""The import of depth images, from the first file to the folder and its report."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from kit1000.capture.camera_files import read_intrinsics
from kit1000.capture.depth_files import read_groups
from kit1000.capture.depth_frames import DepthFrame
from kit1000.capture.intrinsics import Intrinsics
from kit1000.capture.options import ImportOptions
from kit1000.capture.own_folder import write_own_folder
from kit1000.capture.own_scene import OwnScene, own_scene
from kit1000.capture.pose_files import read_pose
from kit1000.capture.scene_report import check_sides, check_size, report
from kit1000.capture.seen_bodies import MOST_BODIES
from kit1000.errors import InputError
from kit1000.files import check_output

RANGES = {"clearance_mm": (0.05, 100.0), "depth_scale": (1e-9, 1.0), "baseline_mm": (1e-3, 1e3)}
"""Least and largest values of options."""
MOST_APART = 10e-3  # [m] between the bodies of images of one scene
SAME_AREA = 1.6  # ratio of the areas of a body as two images show it, at most


def import_scenes(options: ImportOptions) -> list[str]:
    """Import, and return the lines of the report. Raises InputError, and writes nothing, if a source is refused."""
    _check(options)
    clearance = None if options.clearance_mm is None else 1e-3 * options.clearance_mm
    scenes = imported_scenes(options)
    lines = [line for scene in scenes for line in report(scene, clearance)]
    if options.check:
        lines.append(check_size(scenes, [1e-3 * side for side in options.check]))
    if options.one_scene:
        apart = _check_same_bodies(scenes)
        lines.append(
            f"  {len(scenes)} images of one scene, whose bodies lie up to {1e3 * apart:.0f} mm apart: methods of "
            "registration use all of them"
        )
    write_own_folder(options.out, scenes, clearance, options.licence, options.one_scene)
    return lines


def imported_scenes(options: ImportOptions) -> list[OwnScene]:
    """The scenes of an import, before they are written."""
    groups = read_groups(options.sources, options)
    known = [_intrinsics(options, frames) for frames in groups]
    poses = _poses(options, len(groups))
    each_scene = zip(groups, known, poses, strict=True)
    return [own_scene(frames, intrinsics, options, pose) for frames, intrinsics, pose in each_scene]


def bodies_apart(one: OwnScene, other: OwnScene) -> float:
    """How far apart [m] the bodies of two images lie in their world, in the median; infinite if none agree in size.

    A body is compared with the nearest one of a similar area: a wrong pose moves all bodies alike.
    """
    apart = []
    for body in one.bodies:
        alike = [b for b in other.bodies if 1 / SAME_AREA <= body.area / b.area <= SAME_AREA]
        if alike:
            apart.append(min(float(np.linalg.norm(one.place(body) - other.place(b))) for b in alike))
    return float(np.median(apart)) if apart else float("inf")


def _check_same_bodies(scenes: Sequence[OwnScene]) -> float:
    """The largest distance [m] between the bodies of two images; raises InputError if it is above MOST_APART."""
    apart = {(a.source, b.source): bodies_apart(a, b) for a, b in combinations(scenes, 2)}
    (first, second), most = max(apart.items(), key=lambda item: item[1])
    if most > MOST_APART:
        found = f"lie {1e3 * most:.0f} mm apart" if np.isfinite(most) else "have other sizes"
        raise InputError(
            f"--one-scene: the bodies of {first} and {second} {found}, expected up to {1e3 * MOST_APART:.0f} mm: is "
            "each pose that of its image, and did nothing move between them?"
        )
    return most


def _poses(options: ImportOptions, images: int) -> Sequence[Path | None]:
    """The file of the pose of each image; raises InputError for another number of files."""
    poses = options.world_from_camera
    given = len(poses)
    if options.one_scene and not 1 < given == images:
        raise InputError(
            f"--one-scene: expected two images or more, and a pose of each, got {images} and {given} by "
            "--world-from-camera FILE FILE ..."
        )
    if given not in (0, 1, images):
        raise InputError(f"--world-from-camera: expected one file, or one for each of {images} images, got {given}")
    return poses if given == images else [poses[0] if given else None] * images


def _check(options: ImportOptions) -> None:
    """Raise InputError for options that cannot be, before anything is read."""
    check_output(options.out)
    if options.frames < 1 or options.first < 0:
        raise InputError("--frames: expected 1 or more, --first: 0 or more")
    for name, (low, high) in RANGES.items():
        value = getattr(options, name)
        if value is not None and not low <= value <= high:
            raise InputError(f"--{name.replace('_', '-')}: expected {low:g} to {high:g}, got {value:g}")
    if not 1 <= options.kit <= MOST_BODIES:
        raise InputError(f"--kit {options.kit}: expected the number of a body, from 1 to {MOST_BODIES}")
    if options.check:
        check_sides([1e-3 * side for side in options.check])
    for path in options.world_from_camera:
        read_pose(path)


def _intrinsics(options: ImportOptions, frames: Sequence[DepthFrame]) -> Intrinsics | None:
    """The given intrinsics, for the image of some frames."""
    if not options.intrinsics:
        return None
    return read_intrinsics(options.intrinsics, Path(frames[0].source))
