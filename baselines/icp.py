"""Iterative closest points, by Open3D: what the best-known registration method makes of a guess, without learning.

The observed surface of a part is closed to a shell by walls and a floor, down to the table it lies on. Those of its
points that face the kits are moved onto the points of the kits by point-to-plane steps until the fit no longer
improves. A part touches its cavity in few places and stands clear of its walls, and most of a plate looks like the
floor of a cavity, so the nearest fit is seldom the right one.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from baselines.heights.shell import closed_shell
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.perception.observed.pixels import observed_points
from kit1000.perception.restoration import restored_query
from kit1000.pose import Pose, unit_vector
from kit1000.prediction.catalog import Method
from kit1000.predictor import PredictedMotion
from kit1000.queries.guesses import MAX_ANGLE, MAX_OFFSET
from kit1000.queries.tracks import GUESS_TRACKS
from kit1000.values import Query, TrueGeometry

REACHES = (20e-3, 10e-3, 5e-3)  # [m] largest distance between partners: from the error of a guess to the clearance
STEPS = 60  # most, at each reach; few runs take as many
MOST_POINTS = 4000  # of the observed part; its shell has about twice as many
MOST_KITS = 8000  # points of the kits that are fitted to
NEIGHBOURS = 20  # points that a normal is fitted to
FACING = 0.5  # cosine between the normals of part and plate below which a point of the part faces the kits
FEWEST = 50  # points of the kits; with fewer near the guess there is nothing to fit to
GRID_DECIMALS = 7  # of a metre
FARTHEST = MAX_OFFSET * 3**0.5  # [m] no guess is farther off: a result of ICP beyond is wrong

METHODS = {
    "icp": Method(
        "baselines.icp:Icp",
        "from the guess, point-to-plane ICP of the part's shell onto the kits, by Open3D",
        label="ICP from the guess",
        tracks=GUESS_TRACKS,
    ),
}


@dataclass(frozen=True)
class Icp:
    """From the guess, point-to-plane ICP of the part's shell onto the kits."""

    dataset: Dataset

    def __call__(self, query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
        """The motion that ICP converges to; confidence: the share of the shell that then has a partner."""
        if query.guess is None:
            raise InputError(f"{query.id}: ICP begins at a guess, and there is none")
        query, guess = restored_query(query), query.guess
        guessed = guess.apply(query.pivot)
        world_from_middle = Pose(query.view.world_from_camera.wxyz, guessed)
        shell = _in_middle_frame(world_from_middle, guess.apply(shell_of(query)))
        kits = _in_middle_frame(world_from_middle, observed_points(query, query.kit_region))
        reach = np.linalg.norm(shell, axis=1).max() + FARTHEST
        kits = kits[np.linalg.norm(kits, axis=1) < reach]
        if len(kits) < FEWEST:
            return PredictedMotion(guess, 0.0)
        kits = kits[:: -(-len(kits) // MOST_KITS)]
        step, fitness = fitted(shell, kits, _in_middle_frame(world_from_middle, query.view.world_from_camera.xyz))
        if np.linalg.norm(step.xyz) > FARTHEST or step.angle() > MAX_ANGLE:
            return PredictedMotion(guess, 0.0)
        return PredictedMotion(world_from_middle @ step @ world_from_middle.inverse() @ guess, fitness)


def _in_middle_frame(world_from_middle: Pose, points: np.ndarray) -> np.ndarray:
    """(..., 3) [m]: points of the world in a frame about the guessed part, where rotation and shift hardly mix.

    Rounded to a grid, so that the last bit of a pose decides nothing: a round part rotates for as long as ICP runs.
    """
    return world_from_middle.inverse().apply(points).round(GRID_DECIMALS)


def shell_of(query: Query) -> np.ndarray:
    """(n, 3) [m] world: the observed points of a part, their projection on the table z = 0, and walls between them.

    The walls hang from the outline of the part in the image, where the observed surface ends.
    """
    mask = query.part_mask
    return closed_shell(observed_points(query, mask, MOST_POINTS), observed_points(query, mask & ~_inner(mask)))


def _inner(mask: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels whose four neighbours are all in the mask; none at the border of the image."""
    inner = np.zeros_like(mask)
    inner[1:-1, 1:-1] = mask[1:-1, 1:-1] & mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:]
    return inner


def fitted(shell: np.ndarray, kits: np.ndarray, camera: np.ndarray) -> tuple[Pose, float]:
    """The motion of a shell that best fits points of kits, and the share of its facing points that have a partner.

    Args:
        shell: (n, 3) [m] about its middle.
        kits: (m, 3) [m] in the same frame.
        camera: (3,) [m] where the kits were observed from, so that their normals point out of them.
    """
    o3d = load_open3d()
    registration = o3d.pipelines.registration
    target = _cloud(kits)
    target.orient_normals_towards_camera_location(camera)
    outward = np.asarray(_cloud(shell).normals)
    outward = outward * np.sign(np.sum(outward * (shell - shell.mean(0)), axis=1, keepdims=True))
    facing = outward @ unit_vector(np.asarray(target.normals).mean(0)) < FACING
    source = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(shell[facing]))
    criteria = registration.ICPConvergenceCriteria(max_iteration=STEPS)
    motion, fitness = np.eye(4), 0.0
    for reach in REACHES:
        estimate = registration.TransformationEstimationPointToPlane(registration.TukeyLoss(reach / 2))
        result = registration.registration_icp(source, target, reach, motion, estimate, criteria)
        motion, fitness = result.transformation, result.fitness
    return Pose.from_matrix(motion), float(fitness)


def _cloud(points: np.ndarray) -> Any:
    """Open3D's cloud of points (n, 3) [m], with normals of either sign."""
    o3d = load_open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(NEIGHBOURS))
    return cloud


@cache
def load_open3d() -> ModuleType:
    """Open3D, which links to libusb: the wheel that carries that library is loaded first."""
    try:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), ctypes.RTLD_GLOBAL)
        import open3d
    except (ImportError, OSError) as error:
        message = " ".join(str(error).split())
        raise InputError(f"icp: {message}; it needs Open3D: pip install 'kit1000[icp]'") from error
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    open3d.utility.set_max_threads(1)  # several add up in no fixed order
    return open3d
