"""Controls: methods whose score is known beforehand, to show that the benchmark measures what it claims to.

Five read the goals from the ground truth, one keeps the guess, one draws a motion at random. All draws come from a
stream named by the seed, the control and the query.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.perception.calibration import calibrated
from kit1000.perception.observed.pixels import observed_points
from kit1000.pose import Pose
from kit1000.prediction.catalog import Method
from kit1000.predictor import PredictedMotion
from kit1000.queries.guesses import draw_ball_error, draw_direction, draw_goal
from kit1000.queries.motions import apply_error, goal_motion, goal_pose
from kit1000.queries.tracks import GUESS_TRACKS, TRACKS
from kit1000.rng import stream
from kit1000.values import Query, TrueGeometry, View

CERTAIN, UNCERTAIN = 1.0, 0.5  # confidences
NOISE = 2e-3  # [m] from the goal, of truth-noise at the anchor
NOISE_ANGLE = float(np.radians(2))
D415_TRACKS = tuple(name for name, track in TRACKS.items() if track.sensor == "d415")

TRUE = partial(Method, uses_true_geometry=True, control=True)

METHODS = {
    "truth": TRUE(
        "baselines.controls:TrueGoal",
        "the goal itself: every error is 0",
        label="Ground truth",
    ),
    "truth-symmetric": TRUE(
        "baselines.controls:SymmetricGoal",
        "any of the symmetric goals, rotated about the free axis by any angle: every error is 0",
        label="Ground truth at any symmetric goal",
    ),
    "truth-noise": TRUE(
        "baselines.controls:NoisyGoal",
        "the goal, missed by exactly 2 mm and 2 degrees",
        label="Ground truth with 2 mm and 2° error",
    ),
    "truth-calibration": TRUE(
        "baselines.controls:SeenGoal",
        "the goal as the recorded camera pose and depth scale show it: the error of the calibration alone",
        options={"by_table": False},
        label="Ground truth through the recorded calibration",
        tracks=D415_TRACKS,
    ),
    "truth-table": TRUE(
        "baselines.controls:SeenGoal",
        "the same after calibration by the table: its plane, its outline and the band that one imager does not see",
        options={"by_table": True},
        label="Ground truth through calibration by the table",
        tracks=D415_TRACKS,
    ),
    "guess": Method(
        "baselines.controls:guess",
        "the user's initial guess, unchanged",
        label="Initial guess, unchanged",
        tracks=GUESS_TRACKS,
        control=True,
    ),
    "chance": Method(
        "baselines.controls:Chance",
        "a random motion: near the guess or, without one, to a point on the kits at any yaw",
        label="Chance",
        control=True,
    ),
}


@dataclass(frozen=True)
class TrueGoal:
    """The goal that the guess was drawn around; the design pose in tracks without a guess. Every error is 0."""

    dataset: Dataset
    uses_true_geometry = True

    def __call__(self, query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
        """The goal."""
        return PredictedMotion(self.dataset.truth_of(query).goal_drawn, CERTAIN)


@dataclass(frozen=True)
class SymmetricGoal:
    """Any goal of the slot, all equally likely, rotated about the free axis, if there is one, by any angle.

    Every error but the plain ones is 0.
    """

    dataset: Dataset
    seed: int = 0
    uses_true_geometry = True

    def __call__(self, query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
        """A goal."""
        truth = self.dataset.truth_of(query)
        goal, angle = draw_goal(stream(self.seed, "truth-symmetric", query.id), truth.slot)
        seated = goal_pose(truth.slot, goal, angle)
        return PredictedMotion(goal_motion(truth.world_from_part, truth.world_from_kit, seated), CERTAIN)


@dataclass(frozen=True)
class NoisyGoal:
    """The drawn goal, missed at the anchor by NOISE in any direction and by NOISE_ANGLE about any axis through it.

    So the plain errors are exactly these. The others are too where no other goal is near; the component of the
    rotation along a free axis is no error.
    """

    dataset: Dataset
    seed: int = 0
    uses_true_geometry = True

    def __call__(self, query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
        """A goal with a known error."""
        truth, rng = self.dataset.truth_of(query), stream(self.seed, "truth-noise", query.id)
        offset, rotvec = NOISE * draw_direction(rng), NOISE_ANGLE * draw_direction(rng)
        return PredictedMotion(apply_error(truth.goal_drawn, truth.anchor, offset, rotvec), CERTAIN)


@dataclass(frozen=True)
class SeenGoal:
    """The drawn goal, in the world as its depth image shows it.

    The motion takes the part's measured points to their measured goals, both free of noise: what a method predicts that
    is perfect in the camera frame and trusts camera pose and depth scale. On ideal depth it is the goal.
    """

    dataset: Dataset
    by_table: bool
    """Whether pose and scale are first corrected by the table, see `kit1000.perception.calibration`."""
    uses_true_geometry = True

    def __call__(self, query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
        """The goal, seen."""
        true_view = self.dataset.recorded_scene(query.scene_id).view("ideal")
        view = calibrated(query.view, query.image.labels) if self.by_table else query.view
        return PredictedMotion(seen_motion(self.dataset.truth_of(query).goal_drawn, true_view, view), CERTAIN)


def seen_motion(motion: Pose, true_view: View, view: View) -> Pose:
    """A motion of the world as it is, carried into the world as another view of the same camera shows it.

    The view shows a point at the recorded pose applied to its camera coordinates times the depth scale. Its scale is
    the median ratio of the depths of both images.
    """
    both = (view.depth > 0) & (true_view.depth > 0)
    scale = float(np.median(view.depth[both] / true_view.depth[both])) if both.any() else 1.0
    in_camera = true_view.world_from_camera.inverse() @ motion @ true_view.world_from_camera
    scaled = Pose(in_camera.wxyz, in_camera.xyz * scale)
    return view.world_from_camera @ scaled @ view.world_from_camera.inverse()


def guess(query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
    """The user's initial guess, unchanged."""
    if query.guess is None:
        raise InputError(f"{query.id}: track {query.track} has no guess")
    return PredictedMotion(query.guess, UNCERTAIN)


@dataclass(frozen=True)
class Chance:
    """A random motion.

    With a guess: the guess plus a second error of the same kind, up to 28 mm along each axis and a rotation of up to
    27.5 degrees. Without: the pivot goes to any observed point of the kits, the part at any yaw.
    """

    dataset: Dataset
    seed: int = 0

    def __call__(self, query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
        """A motion."""
        rng = stream(self.seed, "chance", query.id)
        if query.guess is not None:
            return PredictedMotion(apply_error(query.guess, query.pivot, *draw_ball_error(rng)), UNCERTAIN)
        points = observed_points(query, query.kit_region)
        if len(points) == 0:
            raise InputError(f"{query.id}: its image shows nothing of the kits")
        there, yaw = points[rng.integers(len(points))], rng.uniform(0, 2 * np.pi)
        upright = Pose.from_translation(there) @ Pose.from_rotvec((0.0, 0.0, yaw))
        return PredictedMotion(upright @ Pose.from_translation(-query.pivot), UNCERTAIN)
