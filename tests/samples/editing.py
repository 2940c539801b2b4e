"""A stage that remembers what it was shown, an asker that remembers what it was asked, and a scene to edit."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from kit1000.camera import look_at
from kit1000.dataset.reader import Dataset
from kit1000.editor.controller import Controller
from kit1000.editor.keys import Interface
from kit1000.editor.pointing import Eye
from kit1000.editor.proposals import Proposal
from kit1000.editor.records import EventLog, Header
from kit1000.editor.scene import EditedScene
from kit1000.editor.texts import Colour
from kit1000.editor.worker import Job, Result
from kit1000.mesh import Mesh
from kit1000.pose import Pose

EYE = Eye(look_at((0.0, -0.9, 0.7), (0.0, 0.0, 0.0)), float(np.radians(45)), 1.6)


@dataclass
class FakeStage:
    """Answers the verbs of a stage with dictionaries."""

    meshes: dict[str, Mesh] = field(default_factory=dict)
    poses: dict[str, Pose] = field(default_factory=dict)
    colours: dict[str, Colour] = field(default_factory=dict)
    hidden: set[str] = field(default_factory=set)
    labels: dict[str, str] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    share: float = 0.0
    gizmo_pose: Pose | None = None
    looks: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)
    flushes: int = 0
    points: dict[str, np.ndarray] = field(default_factory=dict)
    events: list[dict[str, Any]] = field(default_factory=list)

    def show(self, name: str, mesh: Mesh, colour: Colour, opacity: float | None, /) -> None:
        self.meshes[name], self.colours[name] = mesh, colour

    def dots(self, name: str, points: np.ndarray, colours: np.ndarray, /) -> None:
        assert points.shape == colours.shape
        self.points[name], self.colours[name] = points, (0, 0, 0)

    def move(self, name: str, motion: Pose, /) -> None:
        assert name in self.meshes or name in self.points
        self.poses[name] = motion

    def look(self, name: str, /, colour: Colour | None = None, visible: bool | None = None) -> None:
        self.colours[name] = colour or self.colours[name]
        if visible is not None:
            (self.hidden.discard if visible else self.hidden.add)(name)

    def label(self, name: str, text: str, point: ArrayLike, /) -> None:
        self.labels[name] = text

    def say(self, place: str, text: str, /) -> None:
        self.texts[place] = text

    def progress(self, share: float, /) -> None:
        self.share = share

    def gizmo(self, pose: Pose | None, /) -> None:
        self.gizmo_pose = pose

    def look_from(self, eye: ArrayLike, target: ArrayLike, /) -> None:
        self.looks.append((np.asarray(eye), np.asarray(target)))

    def flush(self) -> None:
        self.flushes += 1


@dataclass
class FakeAsker:
    """Keeps what it was asked; the test answers."""

    asked: list[tuple[int, Pose]] = field(default_factory=list)
    preferred: list[int] = field(default_factory=list)

    def ask(self, part: int, guess: Pose) -> None:
        self.asked.append((part, guess))

    def prefer(self, part: int) -> None:
        self.preferred.append(part)


@lru_cache(maxsize=4)
def scene_of(root: Path, sensor: str = "ideal", truth: bool = False, split: str = "test") -> EditedScene:
    """The first scene of a split, open for editing."""
    dataset = Dataset(root)
    return EditedScene.open(dataset, dataset.split(split).scene_ids[0], sensor, truth)


@dataclass
class Desk:
    """A controller with all that it talks to."""

    controller: Controller
    stage: FakeStage
    asker: FakeAsker
    log: EventLog


def header_of(scene: EditedScene, snap: str = "a:b", interface: Interface = "scene") -> Header:
    return Header(scene.dataset.id, scene.recorded.id, scene.sensor, scene.truth, snap, interface)


def desk(
    scene: EditedScene, out: Path, snaps: bool = True, interface: Interface = "scene", moves: bool = False
) -> Desk:
    stage, asker = FakeStage(), FakeAsker()
    log = EventLog(out, header_of(scene, interface=interface), sink=stage.events.append)
    controller = Controller(scene, cast(Any, stage), log, cast(Any, asker) if snaps else None, moves)
    return Desk(controller, stage, asker, log)


def goal(scene: EditedScene, part: int) -> Pose:
    """The true goal_from_now of a part."""
    track = "snap" if scene.sensor == "ideal" else f"snap-{scene.sensor}"
    recorded = scene.dataset.recorded_scene(scene.recorded.id, truth=True)
    query = next(query for query in recorded.queries if query.part == part and query.track == track)
    return recorded.truth_of(query.id).goal_drawn


def off(motion: Pose, pivot: np.ndarray, yaw: float, shift: tuple[float, float, float]) -> Pose:
    """A motion with an error about the image of the pivot."""
    image = motion.apply(pivot)
    about = Pose.from_translation(image) @ Pose.from_rotvec((0, 0, yaw), shift) @ Pose.from_translation(-image)
    return about @ motion


def found(desk: Desk, part: int, *fits: tuple[Pose, float]) -> None:
    """The worker has found these fits without a guess."""
    desk.controller.received(Result(Job(part, None), [Proposal(*fit) for fit in fits]))


def answered(desk: Desk, part: int, guess: Pose, *fits: tuple[Pose, float]) -> None:
    """The worker answers a guess."""
    desk.controller.received(Result(Job(part, guess), [Proposal(*fit) for fit in fits]))


def dragged(desk: Desk, body: int, point: np.ndarray, modifier: str | None = None, steps: int = 3) -> None:
    """Drag a part or a cup so that its pivot goes about to a point (3,) [m]."""
    space = desk.controller.space
    grabbed = space.current[body].goal_from_now.apply(space.pivot(body))
    start, end = EYE.screen(grabbed), EYE.screen(point)
    desk.controller.grab(body, EYE, start, grabbed, modifier)  # type: ignore[arg-type]
    for k in range(1, steps + 1):
        share = k / steps
        desk.controller.drag((start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])))
    desk.controller.release()
