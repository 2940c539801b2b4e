"""Queries as environments of gymnasium: `kit1000/Snap-v0` corrects a guess, `kit1000/Place-v0` finds the slot too.

    env = gymnasium.make("kit1000.gym:kit1000/Snap-v0", data="data/kit1000", split="train")

An episode is one query and one step. The action is the motion of the part in the world, goal_from_now: a quaternion
w, x, y, z, which is normalized, and a translation [m]. The reward is 1 if the motion seats the part, else 0. Importing
this module registers both environments.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any, Literal

import numpy as np

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, did_you_mean
from kit1000.metrics import Targets, pose_errors, seatings
from kit1000.pose import Pose
from kit1000.queries.tracks import TRACKS, Sensor
from kit1000.values import Query, Truth

try:
    gymnasium: Any = importlib.import_module("gymnasium")
except ImportError:  # whoever makes an environment is told
    gymnasium = None

__all__ = ["AssemblyEnv", "motion_vector"]

Observation = dict[str, np.ndarray]
FAR = 100.0  # [m] bound of depths and positions
LARGEST_FOCAL_LENGTH = 1e5  # [px] bound of intrinsics


Env: Any = object if gymnasium is None else gymnasium.Env


class AssemblyEnv(Env):
    """One query an episode; see `docs/guides/gymnasium.md` for the observation and the info."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 (so in gymnasium)

    def __init__(
        self,
        data: str | Path,
        task: Literal["snap", "place"] = "snap",
        split: str = "train",
        sensor: Sensor = "ideal",
        masks: Literal["given", "found"] = "given",
        render_mode: None = None,
    ) -> None:
        """Find the queries, and read the first image for the shapes of the observation.

        Args:
            data: the dataset folder.
            task: snap, with a guess, or place.
            split: train, val, test (one query a scene) or test-all.
            sensor: ideal, d415 or photoneo.
            masks: those of the dataset, or found in the depth image; noisy images need PyTorch for that.
            render_mode: nothing is rendered.

        Raises InputError when gymnasium is missing, or the split has no such queries or no ground truth.
        """
        if gymnasium is None:
            raise InputError("environments need gymnasium: pip install 'kit1000[gym]'")
        track = task if sensor == "ideal" else f"{task}-{sensor}"
        if task not in ("snap", "place") or track not in TRACKS:
            raise InputError(f"no track {track!r} for an environment; there are {', '.join(TRACKS)}")
        if masks not in ("given", "found"):
            raise InputError(f"masks: expected given or found, got {masks!r}")
        self.dataset, self.masks, self.render_mode = Dataset(data), masks, render_mode
        self.split = self.dataset.split(split, truth=True)
        self.scenes = {query.id: query.scene_id for query in self.split.queries(track)}
        """Ids of the queries and of their scenes."""
        if not self.scenes:
            raise InputError(f"{self.dataset.root}: split {split} has no queries in track {track}")
        self.query = self._query(next(iter(self.scenes)))
        """The query of this episode."""
        _ = self._truth  # raises when it is withheld
        image, spaces = self.query.view.depth.shape, gymnasium.spaces
        pose = spaces.Box(np.array([-1.0] * 4 + [-FAR] * 3), np.array([1.0] * 4 + [FAR] * 3), dtype=np.float64)
        named: dict[str, Any] = {
            "depth": spaces.Box(0.0, FAR, image, np.float32),
            "part": spaces.MultiBinary(image),
            "kits": spaces.MultiBinary(image),
            "intrinsics": spaces.Box(0.0, LARGEST_FOCAL_LENGTH, (3, 3), np.float64),
            "world_from_camera": pose,
            "pivot": spaces.Box(-FAR, FAR, (3,), np.float64),
        }
        self.observation_space = spaces.Dict(named | ({"guess": pose} if task == "snap" else {}))
        self.action_space = spaces.Box(-1.0, 1.0, (7,), np.float64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode about a random query, or about the one of id `options["query"]`."""
        super().reset(seed=seed)
        names = list(self.scenes)
        chosen = (options or {}).get("query") or names[self.np_random.integers(len(names))]
        if chosen not in self.scenes:
            raise InputError(f"no query {chosen!r} in this environment; {did_you_mean(chosen, names)}see .scenes")
        self.query = self._query(chosen)
        return self._observation(), {"query": chosen}

    def step(self, action: np.ndarray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Evaluate a motion, which ends the episode.

        Raises InputError if the action is not seven finite numbers, or its quaternion is zero.
        """
        numbers = np.asarray(action, np.float64)
        if numbers.shape != (7,) or not np.isfinite(numbers).all() or not numbers[:4].any():
            raise InputError(f"action: expected a quaternion w, x, y, z and a translation, got {numbers}")
        info = self._scores(Pose(numbers[:4], numbers[4:]))
        return self._observation(), float(info["seated"]), True, False, info

    @property
    def _truth(self) -> Truth:
        return self.split.scene(self.query.scene_id).truth_of(self.query.id)

    def _query(self, name: str) -> Query:
        query = next(query for query in self.split.scene(self.scenes[name]).queries if query.id == name)
        if self.masks == "given":
            return query
        from kit1000.perception.segmentation.predicted_masks import with_predicted_masks
        from kit1000.perception.sensor_facts import sensor_of

        summary = self.dataset.summary
        facts = sensor_of(summary, query.sensor, query.scene_id)
        return with_predicted_masks(query, summary["config"]["scale"], facts)

    def _observation(self) -> Observation:
        """New arrays, since those of the dataset are shared and read-only."""
        query, view = self.query, self.query.view
        seen = {
            "depth": view.depth.copy(),
            "part": query.part_mask.view(np.int8),
            "kits": query.kit_region.view(np.int8),
            "intrinsics": view.camera.K,
            "world_from_camera": motion_vector(view.world_from_camera),
            "pivot": query.pivot.copy(),
        }
        return seen if query.guess is None else seen | {"guess": motion_vector(query.guess)}

    def _scores(self, motion: Pose) -> dict[str, Any]:
        """The metrics of a motion; lengths in m, angles in rad."""
        truth, predicted = self._truth, Pose.stack([motion])
        targets = Targets.of([truth], lambda part_id: self.dataset.geometry.part(part_id).mesh.vertices)
        errors, seating = pose_errors(predicted, targets), seatings(predicted, [truth], self.dataset.geometry)
        return {
            "query": self.query.id,
            "seated": bool(seating.seated[0]),
            "strict": bool(seating.strict[0]),
            "position": float(errors.position[0]),
            "rotation": float(errors.rotation[0]),
            "mssd": float(errors.mssd[0]),
            "offset": float(seating.contact_offset[0]),
        }


def motion_vector(pose: Pose) -> np.ndarray:
    """(7,) a pose as an action or an observation has it: w, x, y, z, then a position or translation [m]."""
    return np.concatenate([pose.wxyz, pose.xyz])


if gymnasium is not None:
    for task in ("snap", "place"):
        gymnasium.register(f"kit1000/{task.capitalize()}-v0", f"{__name__}:AssemblyEnv", kwargs={"task": task})
