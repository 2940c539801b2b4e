"""What predictions are measured against: the goals, hulls and free axes of many queries, packed into flat arrays.

Everything is in the world frame and in metres; a goal is a motion `goal_from_now`, as a prediction is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from kit1000.errors import ShapeError, checked
from kit1000.pose import Pose, unit_vector
from kit1000.queries.motions import goal_motion
from kit1000.values import Truth

NO_AXIS = np.full(3, np.nan)
UNIT_TOLERANCE = 1e-9  # allowed difference of a direction's length from 1


@dataclass(frozen=True, eq=False)
class Targets:
    """Ground truth of n queries with m goals in all, about s parts with v hull vertices in all. Read-only."""

    anchors: np.ndarray
    """(n, 3) [m] the current position of each part's centroid."""
    goals: Pose
    """(m,) goal_from_now of every goal of every query, query after query."""
    goal_starts: np.ndarray
    """(n + 1,) int: query i has the goals goal_starts[i] to goal_starts[i + 1]."""
    axis_points: np.ndarray
    """(n, 3) [m] a point on the axis about which a goal may be rotated freely; NaN where there is none."""
    axis_directions: np.ndarray
    """(n, 3) unit vectors along that axis; NaN where there is none."""
    hulls: np.ndarray
    """(v, 3) [m] vertices of the convex hulls of the parts, in part frames."""
    hull_starts: np.ndarray
    """(s + 1,) int: hull k has the vertices hull_starts[k] to hull_starts[k + 1]."""
    hull_index: np.ndarray
    """(n,) int: the hull of each query's part."""
    world_from_part: Pose
    """(n,) the current pose of each part."""
    goals_drawn: Pose
    """(n,) goal_from_now of the one goal that plain errors are measured against."""

    def __post_init__(self) -> None:
        n = len(checked("anchors", self.anchors, ("n", 3)))
        _set_checked(self, "anchors", (n, 3))
        _set_checked(self, "goal_starts", (n + 1,), np.int64)
        _set_checked(self, "hulls", ("v", 3))
        _set_checked(self, "hull_starts", ("s + 1",), np.int64)
        _set_checked(self, "hull_index", (n,), np.int64)
        for name, count in (("goals", self.goal_starts[-1]), ("world_from_part", n), ("goals_drawn", n)):
            check_poses(name, getattr(self, name), int(count))
        _check_starts("goal_starts", self.goal_starts, len(self.goals))
        _check_starts("hull_starts", self.hull_starts, len(self.hulls))
        if n and not 0 <= self.hull_index.min() <= self.hull_index.max() < len(self.hull_starts) - 1:
            low, high = self.hull_index.min(), self.hull_index.max()
            raise ShapeError(f"hull_index: expected 0 to {len(self.hull_starts) - 2}, got {low} to {high}")
        _set_free_axes(self, n)

    @staticmethod
    def of(truths: Sequence[Truth], hull_of: Callable[[str], np.ndarray]) -> Targets:
        """The targets of n ground truths.

        hull_of: returns the hull vertices (v, 3) [m] of a part by its id, in the part's frame; called once a part. All
        vertices of the mesh give the same result, more slowly.
        """
        parts = list(dict.fromkeys(truth.part_id for truth in truths))
        hulls = [checked(f"hull of {part}", hull_of(part), ("v", 3)) for part in parts]
        number = {part: k for k, part in enumerate(parts)}
        counts = [len(truth.slot.goals) for truth in truths]
        query = np.repeat(np.arange(len(truths)), counts)
        world_from_part = Pose.stack([truth.world_from_part for truth in truths])
        world_from_kit = Pose.stack([truth.world_from_kit for truth in truths])
        goals = [truth.slot.goals for truth in truths]
        kit_from_part = Pose(_concatenated([g.wxyz for g in goals], 4), _concatenated([g.xyz for g in goals], 3))
        axes = [truth.slot.free_axis for truth in truths]
        return Targets(
            anchors=np.array([truth.anchor for truth in truths]).reshape(-1, 3),
            goals=goal_motion(world_from_part[query], world_from_kit[query], kit_from_part),
            goal_starts=run_starts(counts),
            axis_points=world_from_kit.apply(_concatenated([NO_AXIS if a is None else a.point for a in axes], 3)),
            axis_directions=world_from_kit.rotate(
                _concatenated([NO_AXIS if a is None else a.direction for a in axes], 3)
            ),
            hulls=_concatenated(hulls, 3),
            hull_starts=run_starts([len(hull) for hull in hulls]),
            hull_index=np.array([number[truth.part_id] for truth in truths], dtype=np.int64),
            world_from_part=world_from_part,
            goals_drawn=Pose.stack([truth.goal_drawn for truth in truths]),
        )

    def __len__(self) -> int:
        return len(self.anchors)

    def __getitem__(self, index: np.ndarray | slice) -> Targets:
        """Some of the queries, by an array of indices, a mask or a slice; the hulls of all parts are kept."""
        rows = np.arange(len(self))[index]
        if rows.ndim != 1:
            raise IndexError("targets are indexed by a slice, a mask or a one-dimensional array")
        counts = np.diff(self.goal_starts)[rows]
        starts = run_starts(counts)
        goals = np.arange(starts[-1]) + np.repeat(self.goal_starts[:-1][rows] - starts[:-1], counts)
        return Targets(
            anchors=self.anchors[rows],
            goals=self.goals[goals],
            goal_starts=starts,
            axis_points=self.axis_points[rows],
            axis_directions=self.axis_directions[rows],
            hulls=self.hulls,
            hull_starts=self.hull_starts,
            hull_index=self.hull_index[rows],
            world_from_part=self.world_from_part[rows],
            goals_drawn=self.goals_drawn[rows],
        )

    @property
    def query_of_goal(self) -> np.ndarray:
        """(m,) int: the query that each goal belongs to."""
        return np.repeat(np.arange(len(self)), np.diff(self.goal_starts))

    @property
    def has_free_axis(self) -> np.ndarray:
        """(n,) bool: whether the goals of a query may be rotated freely about an axis."""
        return ~np.isnan(self.axis_directions[:, 0])


def check_poses(name: str, poses: Pose, count: int) -> None:
    """Raise ShapeError for anything but a batch of `count` poses."""
    if not isinstance(poses, Pose):
        raise ShapeError(f"{name}: expected a Pose of {count}, got {type(poses).__name__}")
    if poses.batch_shape != (count,):
        raise ShapeError(f"{name}: expected a batch of shape ({count},), one a row, got {poses.batch_shape}")


def run_starts(counts: Sequence[int] | np.ndarray) -> np.ndarray:
    """(k + 1,) int: the start of each of k runs of these lengths, and the end of the last."""
    return np.concatenate([[0], np.cumsum(np.asarray(counts, dtype=np.int64))])


def _concatenated(rows: Sequence[np.ndarray], width: int) -> np.ndarray:
    """Rows and batches of rows stacked, (k, width); also when there are none."""
    return np.concatenate([np.empty((0, width)), *(np.atleast_2d(row) for row in rows)])


def _set_checked(targets: Targets, name: str, shape: tuple[int | str, ...], dtype: type = np.float64) -> None:
    object.__setattr__(targets, name, checked(name, getattr(targets, name), shape, dtype))


def _check_starts(name: str, starts: np.ndarray, end: int) -> None:
    if not len(starts) or starts[0] != 0 or starts[-1] != end or (np.diff(starts) < 1).any():
        raise ShapeError(f"{name}: expected increasing numbers from 0 to {end}, got {starts}")


def _set_free_axes(targets: Targets, n: int) -> None:
    """Check and set the free axes, each of which is finite or all NaN."""
    arrays = [np.asarray(array, float) for array in (targets.axis_points, targets.axis_directions)]
    for name, array in zip(("axis_points", "axis_directions"), arrays, strict=True):
        if array.shape != (n, 3):
            raise ShapeError(f"{name}: expected float64 of shape ({n}, 3), got shape {array.shape}")
    both = np.stack(arrays, axis=1)
    none = np.asarray(np.isnan(both).all(axis=(1, 2)))
    points = checked("axis_points", np.where(none[:, None], 0.0, both[:, 0]), (n, 3))
    directions = unit_vector(np.where(none[:, None], (0.0, 0.0, 1.0), both[:, 1]), "axis_directions")
    off = np.abs(np.linalg.norm(both[~none, 1], axis=1) - 1)
    if (off > UNIT_TOLERANCE).any():
        raise ShapeError(f"axis_directions: expected unit vectors, got a length off by {off.max():.3g}")
    for name, finite in (("axis_points", points), ("axis_directions", directions)):
        array = np.where(none[:, None], np.nan, finite)
        array.setflags(write=False)
        object.__setattr__(targets, name, array)
