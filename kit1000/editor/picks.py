"""Where a gripper may take a part and along which axis it goes in, from what one depth image shows.

The pick is found in the frame of the camera put level: as the robot of `kit1000 run` finds it, but the same wherever
the origin of the world lies on the table.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kit1000.editor.moves import FramedMove, Move
from kit1000.editor.pointing import Pointing
from kit1000.editor.scene import EditedScene
from kit1000.editor.seen_plates import TABLE
from kit1000.editor.session import Session
from kit1000.kits.seating import UP
from kit1000.numerics.linear_algebra import length, matmul
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.planner.grasp import best_grasp
from kit1000.pose import Pose
from kit1000.queries.pivots import extent_centre
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, View

DOWN = Pose.from_rotvec((np.pi, 0.0, 0.0))
"""Rotation of the grip in a level frame: z down into the part, x along that of the frame."""
LEVEL = 0.5  # least level length of the camera's x axis, by which the grip is turned
UPRIGHT = np.cos(np.radians(20))  # between the carried vertical and a plate's normal: the part lies as it is inserted
TOP = 99  # percentile of the heights of a part, of its top: flying pixels are higher


class Pick(NamedTuple):
    """Where a part may be taken."""

    world_from_grip: Pose
    cup: float | None  # [m] radius of the largest suction cup that seals there; None if none does


def find_pick(image: LabelledDepth, part: int, sensor: str) -> Pick:
    """The pick of a part: where the largest cup seals best, else the top of its middle.

    image: as the sensor saw it; z = 0 of its world is the table.
    """
    world_from_level = level_frame(image.view)
    camera = world_from_level.inverse() @ image.view.world_from_camera
    level = replace(image, view=replace(image.view, world_from_camera=camera))
    grasp = best_grasp(level, part, simulated_sensor(sensor).kind.flatness)
    point, cup = (_top(level, part), None) if grasp is None else (grasp.point, grasp.cup)
    return Pick(world_from_level @ Pose(DOWN.wxyz, point), cup)


def level_frame(view: View) -> Pose:
    """world_from_level: the origin on the table below the camera, z up, x to the right of the image.

    If the image is rotated by a quarter turn, x is downwards in it.
    """
    right, down = view.world_from_camera.rotate(np.eye(3)[:2]) * (1.0, 1.0, 0.0)
    x = right if length(right) > LEVEL else down
    yaw = float(np.arctan2(x[1], x[0]))
    return Pose.from_rotvec((0.0, 0.0, yaw), view.world_from_camera.xyz * (1.0, 1.0, 0.0))


def insertion_axis(motion: Pose, normal: np.ndarray | None) -> tuple[np.ndarray, bool]:
    """(3,) the insertion axis of a part that a motion puts on a plate, and whether the part lies as it is inserted.

    The axis is the vertical, rotated by the motion, as for the robot. If it leans away from the plate's normal (3,),
    the part lies on another face than the one it is inserted on, and the axis is the normal. None: unknown plate.
    """
    carried = motion.rotate(UP)
    upright = normal is None or bool(matmul(carried, normal) > UPRIGHT)
    return (carried, True) if normal is None or upright else (normal, False)


def moves_of(scene: EditedScene, session: Session, pointing: Pointing, picks: dict[int, Pick]) -> list[Move]:
    """The moves of the confirmed parts of a scene. picks: those found so far, by part; further ones are added."""
    moves = []
    for part in scene.parts:
        edit = session.edits.get(part)
        if edit is None or not edit.confirmed:
            continue
        image = scene.image
        if part not in picks:
            picks[part] = find_pick(image, part, scene.sensor)
        plate = pointing.below(edit.goal_from_now.apply(scene.pivot(part)))
        axis, upright = insertion_axis(edit.goal_from_now, None if plate is TABLE else plate.normal)
        framed = FramedMove(edit.goal_from_now, picks[part].world_from_grip, axis)
        moves.append(
            Move(
                scene=scene.recorded.id,
                sensor=scene.sensor,
                part=part,
                confidence=edit.confidence,
                from_above=upright,
                cup=picks[part].cup,
                world=framed,
                world_from_camera=image.view.world_from_camera,
                base_from_camera=scene.base_from_camera,
            )
        )
    return moves


def _top(image: LabelledDepth, part: int) -> np.ndarray:
    """(3,) [m] world: above the middle of what is seen of a part, at the height of its top."""
    view, mask = image.view, image.labels == FIRST_PART_LABEL + part
    rows, columns = np.nonzero(mask & (view.depth > 0))
    middle = extent_centre(view, mask)
    if middle is None:
        return view.world_from_camera.xyz * (1.0, 1.0, 0.0)
    pixels = np.stack([columns, rows], axis=-1)
    heights = view.world_from_camera.apply(view.camera.unproject_pixels(pixels, view.depth[rows, columns]))[:, 2]
    return np.array([*middle[:2], np.percentile(heights, TOP)])
