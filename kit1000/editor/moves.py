"""moves.json: how a robot carries the confirmed parts, in the frames of the table, of the camera and of the robot.

A part that nobody has seen before has no frame of its own. So a *grip* frame is laid on it where a gripper may take it,
z into the part; the poses of a move are those of that frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.dataset.pose_files import stated_pose
from kit1000.dataset.tables import Row, pose_row
from kit1000.errors import InputError, checked
from kit1000.files import read_json, write_json
from kit1000.kits.seating import HOVER
from kit1000.numerics.linear_algebra import length
from kit1000.pose import Pose, unit_vector

FILE = "moves.json"
FORMAT = "kit1000/moves/1"
TOLERANCE = 1e-6  # [m], [rad] to which the frames of a move agree
POSES = ("motion", "pick", "hover", "seated")


@dataclass(frozen=True, eq=False)
class FramedMove:
    """A move in one frame."""

    motion: Pose
    """goal_from_now of the part: maps its points from where they are to where they go."""
    pick: Pose
    """frame_from_grip where the part lies."""
    axis: np.ndarray
    """(3,) unit: the insertion axis, out of the cavity."""

    @property
    def seated(self) -> Pose:
        """frame_from_grip where the part is inserted."""
        return self.motion @ self.pick

    @property
    def hover(self) -> Pose:
        """frame_from_grip HOVER out along the axis, from where the way in is straight."""
        return Pose.from_translation(HOVER * self.axis) @ self.seated

    def seen_from(self, other_from_frame: Pose) -> FramedMove:
        """The same move in another frame."""
        motion = other_from_frame @ self.motion @ other_from_frame.inverse()
        return FramedMove(motion, other_from_frame @ self.pick, other_from_frame.rotate(self.axis))


@dataclass(frozen=True, eq=False)
class Move:
    """How a confirmed part goes into its cavity."""

    scene: str
    """Id of the scene."""
    sensor: str
    """Sensor of the depth image that was edited."""
    part: int
    """Index among the parts of the scene."""
    confidence: float
    """0 to 1: of the fit that was taken; 0 for a part placed by hand alone."""
    from_above: bool
    """Whether the part lies on the face that goes onto the floor: a gripper from above then carries it in."""
    cup: float | None
    """[m] radius of the largest suction cup that seals at the pick; None where none of the robot's does."""
    world: FramedMove
    """In the frame of the table."""
    world_from_camera: Pose
    base_from_camera: Pose | None = None
    """The camera in the base of the user's robot; None where nobody has stated it."""

    def __post_init__(self) -> None:
        if not 0 <= checked("confidence", self.confidence, ()) <= 1:
            raise InputError(f"confidence: expected 0 to 1, got {self.confidence}")

    @cached_property
    def camera(self) -> FramedMove:
        """In the frame of the camera, as OpenCV has it: x right, y down, z forward."""
        return self.world.seen_from(self.world_from_camera.inverse())

    @cached_property
    def base(self) -> FramedMove | None:
        """In the base of the robot; None where its pose is not stated."""
        return None if self.base_from_camera is None else self.camera.seen_from(self.base_from_camera)

    @property
    def key(self) -> tuple[str, str]:
        """Scene and sensor: moves with the same belong to one session."""
        return self.scene, self.sensor


def read_moves(path: str | Path) -> list[Move]:
    """The moves of a file or of the folder that holds it.

    Raises InputError where it is missing, in another format, or says different things in different frames.
    """
    file = Path(path) / FILE if Path(path).is_dir() else Path(path)
    return [_move_of(row, f"{file}: move {number}") for number, row in enumerate(_rows(file, None))]


def write_moves(folder: Path, dataset_id: str, key: tuple[str, str], moves: Sequence[Move]) -> None:
    """Write the moves of a scene and sensor into a folder, beside those of others; no file where there are none."""
    path = folder / FILE
    others = [] if not path.is_file() else [row for row in _rows(path, dataset_id) if _key(row) != key]
    rows = sorted([*others, *map(_move_row, moves)], key=lambda row: (*_key(row), row["part"]))
    if rows:
        write_json(path, {"format": FORMAT, "dataset_id": dataset_id, "moves": rows})
    else:
        path.unlink(missing_ok=True)


def _rows(path: Path, dataset_id: str | None) -> list[Row]:
    """The rows of a file, of a dataset where one is named."""
    found = read_json(path)
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise InputError(f"{path}: expected a file of format {FORMAT!r}; kit1000 edit writes it: name another --out")
    if dataset_id is not None and found.get("dataset_id") != dataset_id:
        raise InputError(f"{path}: is about dataset {found.get('dataset_id')}, not {dataset_id}; choose another --out")
    rows = found.get("moves")
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(f"{path}: expected a list of moves")
    for number, row in enumerate(rows):
        _checked_key(row, f"{path}: move {number}")
    return rows


def _key(row: Row) -> tuple[str, str]:
    return row["scene"], row["sensor"]


def _checked_key(row: Row, place: str) -> None:
    kinds = {"scene": str, "sensor": str, "part": int}
    for name, kind in kinds.items():
        if not isinstance(row.get(name), kind) or isinstance(row[name], bool):
            raise InputError(f"{place}: {name} is {row.get(name)!r}; kit1000 edit writes the file anew")


def _move_row(move: Move) -> Row:
    base = move.base_from_camera
    return {
        "scene": move.scene,
        "sensor": move.sensor,
        "part": move.part,
        "confidence": move.confidence,
        "from_above": move.from_above,
        "cup": move.cup,
        "world_from_camera": pose_row(move.world_from_camera),
        "base_from_camera": None if base is None else pose_row(base),
        "world": _framed_row(move.world),
        "camera": _framed_row(move.camera),
        "base": None if move.base is None else _framed_row(move.base),
    }


def _framed_row(move: FramedMove) -> Row:
    return {**{name: pose_row(getattr(move, name)) for name in POSES}, "axis": move.axis.tolist()}


def _move_of(row: Row, place: str) -> Move:
    """The move of a row; its frames must agree."""
    place = f"{place} ({row['scene']}, part {row['part']})"
    try:
        world = row["world"]
        base = row["base_from_camera"]
        move = Move(
            scene=row["scene"],
            sensor=row["sensor"],
            part=row["part"],
            confidence=float(row["confidence"]),
            from_above=bool(row["from_above"]),
            cup=None if row["cup"] is None else float(row["cup"]),
            world=FramedMove(
                stated_pose(world["motion"], "world.motion"),
                stated_pose(world["pick"], "world.pick"),
                unit_vector(checked("world.axis", np.array(world["axis"], float), (3,))),
            ),
            world_from_camera=stated_pose(row["world_from_camera"], "world_from_camera"),
            base_from_camera=None if base is None else stated_pose(base, "base_from_camera"),
        )
        faults = [fault for name in ("world", "camera", "base") for fault in _differing(name, getattr(move, name), row)]
    except KeyError as error:
        raise InputError(f"{place}: has no {error}") from None
    except (TypeError, ValueError, InputError) as error:
        raise InputError(f"{place}: {error}") from None
    if faults:
        raise InputError(f"{place}: {faults[0]} disagrees with motion and pick of the world: was the file edited?")
    return move


def _differing(name: str, move: FramedMove | None, row: Row) -> Iterable[str]:
    """The values of a frame that a row states differently."""
    if move is None or row[name] is None:
        if move is not None or row[name] is not None:
            yield name
        return
    for pose in POSES:
        stated = stated_pose(row[name][pose], f"{name}.{pose}")
        apart = stated.inverse() @ getattr(move, pose)
        if max(length(apart.xyz), float(apart.angle())) > TOLERANCE:
            yield f"{name}.{pose}"
    stated_axis: Any = checked(f"{name}.axis", np.array(row[name]["axis"], float), (3,))
    if length(stated_axis - move.axis) > TOLERANCE:
        yield f"{name}.axis"
