"""moves.json: how a robot carries the confirmed parts, in the frames of the table, of the camera and of the robot.

The poses of a move are those of a *grip* frame: it lies on the part where a gripper may take it, with z into the part.
A `Move` holds the frame of the table and the poses of the camera, from which the other frames follow. The file has all
frames, so that a program needs no further computation; when it is read back, only the first one is used.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from kit1000.dataset.json_rows import Row, pose_row
from kit1000.errors import InputError, ShapeError, checked
from kit1000.files import read_json, write_json
from kit1000.kits.seating import HOVER
from kit1000.numerics.linear_algebra import length
from kit1000.pose import Pose

FILE = "moves.json"
FORMAT = "kit1000/moves/1"
POSES = ("motion", "pick", "hover", "seated")


@dataclass(frozen=True, eq=False)
class FramedMove:
    """A move in one frame."""

    motion: Pose  # goal_from_now of the part: maps its points from their recorded place to their goal
    pick: Pose  # frame_from_grip at the recorded pose of the part
    axis: np.ndarray  # (3,) unit: the insertion axis, out of the cavity

    def __post_init__(self) -> None:
        if not abs(length(checked("axis", self.axis, (3,))) - 1) < 1e-6:
            raise ShapeError(f"axis: expected a unit vector, got {self.axis}")

    @property
    def seated(self) -> Pose:
        """frame_from_grip at the inserted pose of the part."""
        return self.motion @ self.pick

    @property
    def hover(self) -> Pose:
        """frame_from_grip at the distance HOVER out along the axis; from there the path into the cavity is straight."""
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
    confidence: Annotated[float, msgspec.Meta(ge=0, le=1)]
    """0 to 1: of the fit that was taken; 0 for a part placed by hand alone."""
    from_above: bool
    """Whether the part lies on the face that goes onto the floor: then a gripper from above can insert it."""
    cup: float | None
    """[m] radius of the largest suction cup that seals at the pick; None if none of the robot's does."""
    world: FramedMove
    """In the frame of the table."""
    world_from_camera: Pose
    base_from_camera: Pose | None = None
    """The camera in the base of the user's robot; None if it is not stated."""

    @cached_property
    def camera(self) -> FramedMove:
        """In the frame of the camera, as OpenCV has it: x right, y down, z forward."""
        return self.world.seen_from(self.world_from_camera.inverse())

    @cached_property
    def base(self) -> FramedMove | None:
        """In the base of the robot; None if its pose is not stated."""
        return None if self.base_from_camera is None else self.camera.seen_from(self.base_from_camera)


class _MovesFile(msgspec.Struct):
    """The contents of moves.json."""

    format: Literal["kit1000/moves/1"]
    dataset_id: str
    moves: list[Move]


def read_moves(path: str | Path) -> list[Move]:
    """The moves of a file or of the folder that holds it; raises InputError if it is missing or in another format."""
    file = Path(path) / FILE if Path(path).is_dir() else Path(path)
    return _checked(file, read_json(file)).moves


def write_moves(
    folder: Path, dataset_id: str, key: tuple[str, str], moves: Sequence[Move], kept: Collection[int] = ()
) -> None:
    """Write the moves of a scene and sensor into a folder, beside those of others; no file if there are none.

    kept: parts of the scene whose moves stay as the file has them.
    """
    path, others = folder / FILE, []
    if path.is_file():
        found = read_json(path)
        known = _checked(path, found)
        if known.dataset_id != dataset_id:
            raise InputError(f"{path}: is about dataset {known.dataset_id}, not {dataset_id}; choose another --out")
        pairs = zip(found["moves"], known.moves, strict=True)
        others = [row for row, move in pairs if (move.scene, move.sensor) != key or move.part in kept]
    rows = sorted([*others, *map(_row, moves)], key=lambda row: (row["scene"], row["sensor"], row["part"]))
    if rows:
        write_json(path, {"format": FORMAT, "dataset_id": dataset_id, "moves": rows})
    else:
        path.unlink(missing_ok=True)


def _checked(path: Path, value: Any) -> _MovesFile:
    """The checked contents of a file; raises InputError that names file and field."""
    try:
        return msgspec.convert(value, _MovesFile, dec_hook=_vector)
    except (msgspec.ValidationError, InputError) as error:
        raise InputError(f"{path}: {error}; kit1000 edit writes {FORMAT} anew into another --out") from None


def _vector(kind: type[Any], value: Any) -> np.ndarray:
    """The array (n,) of a pose or an axis; msgspec adds the field to an error."""
    try:
        return checked("numbers", np.array(value, float), ("n",))
    except TypeError as error:
        raise ValueError(str(error)) from None


def _row(move: Move) -> Row:
    frames = {"world": move.world, "camera": move.camera, "base": move.base}
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
        **{name: None if frame is None else _frame_row(frame) for name, frame in frames.items()},
    }


def _frame_row(move: FramedMove) -> Row:
    return {**{name: pose_row(getattr(move, name)) for name in POSES}, "axis": move.axis.tolist()}
