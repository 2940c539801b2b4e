"""The animated picture of an edit: a scripted hand at the controller of the page, on a stage that draws frames.

    python docs/pictures/editor.py data/kit1000

Whatever the hand does goes through the editor as on the page; of the goals it knows what a person sees, roughly.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw, ImageFont

from kit1000.camera import Camera, look_at
from kit1000.cli.scenes import SNAP
from kit1000.dataset.reader import Dataset
from kit1000.editor.controller import Controller
from kit1000.editor.display import FIELD, framed
from kit1000.editor.pointing import Eye
from kit1000.editor.records import EventLog, Header
from kit1000.editor.scene import EditedScene
from kit1000.editor.texts import Colour
from kit1000.editor.worker import Job, Method, Result, prepared, proposals_of
from kit1000.mesh import Mesh
from kit1000.pictures.shading import INK, PAPER, ColouredBody, shaded_picture
from kit1000.pose import Pose

OUT = Path(__file__).with_suffix(".webp")
SCENE = "test-s0002"
WIDTH, HEIGHT, CAPTION = 720, 450, 34  # [px]
WORDS = {"▸ ": "", " ○": "", "◆": "snapped", "◇": "not sure", "✔": "confirmed"}  # Pillow's font is without the marks
OFF = np.array([0.006, 0.005, 0.0])  # [m] of the hand from the goal
STEPS = 7  # of a drag
QUALITY = 72
ARROW = np.array([(0, 0), (0, 17), (4, 13), (7, 20), (10, 19), (7, 12), (13, 12)])  # [px]


class AtOnce:
    """Answers guesses in this process, before the call returns."""

    def __init__(self, method: Method) -> None:
        self._method = method
        self._done: Callable[[Result], None] | None = None

    def start(self, done: Callable[[Result], None]) -> None:
        """Answer from now on. done: called with each result."""
        self._done = done

    def ask(self, part: int, guess: Pose | None) -> None:
        """Answer a guess, or find all fits without one."""
        job = Job(part, guess)
        if self._done is not None:
            self._done(Result(job, proposals_of(prepared(self._method), job)))

    def prefer(self, part: int) -> None:
        """The part in the hand: nothing waits."""


class Body(NamedTuple):
    """A mesh on the film."""

    mesh: Mesh
    motion: Pose
    colour: Colour
    opacity: float
    visible: bool


class Recording(Protocol):
    """A stage that records."""

    eye: Eye

    def take(self, caption: str, milliseconds: int, pointer: tuple[float, float] | None = None) -> None:
        """Take a frame. pointer: on the screen, 0 to 1 from the left, and from the top."""
        ...


Recorder = TypeVar("Recorder", bound=Recording)


class Film:
    """The verbs of a stage that a picture needs; the others do nothing."""

    def __init__(self, eye: Eye) -> None:
        self.eye = eye
        self.bodies: dict[str, Body] = {}
        self.labels: dict[str, tuple[str, np.ndarray]] = {}
        self.frames: list[Image.Image] = []
        self.milliseconds: list[int] = []

    def show(self, name: str, mesh: Mesh, colour: Colour, opacity: float | None) -> None:
        """Add a mesh."""
        self.bodies[name] = Body(mesh, Pose.identity(), colour, opacity or 1.0, True)

    def move(self, name: str, motion: Pose) -> None:
        """Move a mesh."""
        self.bodies[name] = self.bodies[name]._replace(motion=motion)

    def look(self, name: str, colour: Colour | None = None, visible: bool | None = None) -> None:
        """Change what a mesh looks like."""
        body = self.bodies[name]
        shown = body.visible if visible is None else visible
        self.bodies[name] = body._replace(colour=colour or body.colour, visible=shown)

    def label(self, name: str, text: str, point: ArrayLike) -> None:
        """Write a label."""
        self.labels[name] = text, np.asarray(point, float)

    def __getattr__(self, verb: str) -> object:
        return lambda *arguments, **options: None

    def take(self, caption: str, milliseconds: int, pointer: tuple[float, float] | None = None) -> None:
        """Take a frame."""
        visible = [body for body in self.bodies.values() if body.visible]
        solid = [body for body in visible if body.opacity == 1]
        picture = self._rendered(solid)
        if len(solid) < len(visible):
            picture = Image.blend(picture, self._rendered(visible), min(body.opacity for body in visible))
        frame = Image.new("RGB", (WIDTH, HEIGHT + CAPTION), PAPER)
        frame.paste(picture)
        draw = ImageDraw.Draw(frame)
        for text, point in self.labels.values():
            if text:
                x, y = self.eye.screen(point)
                _write(draw, (x * WIDTH, y * HEIGHT), _worded(text))
        if pointer is not None:
            corners = ARROW + (pointer[0] * WIDTH, pointer[1] * HEIGHT)
            draw.polygon([(x, y) for x, y in corners.tolist()], fill="white", outline="black")
        draw.text((12, HEIGHT + CAPTION / 2), caption, fill=INK, font=ImageFont.load_default(size=16), anchor="lm")
        self.frames.append(frame)
        self.milliseconds.append(milliseconds)

    def _rendered(self, bodies: list[Body]) -> Image.Image:
        coloured = [ColouredBody(body.mesh, body.motion, body.colour) for body in bodies]
        focal = HEIGHT / 2 / float(np.tan(FIELD / 2))
        camera = Camera(WIDTH, HEIGHT, focal, focal, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
        return Image.fromarray(shaded_picture(coloured, camera, self.eye.world_from_camera))


def main(data: Path) -> None:
    """Edit the scene, and write the film."""
    film = recorded(data, Film)
    film.frames[0].save(
        OUT, save_all=True, append_images=film.frames[1:], duration=film.milliseconds, loop=0, quality=QUALITY, method=6
    )


def recorded(data: Path, make: Callable[[Eye], Recorder]) -> Recorder:
    """What records an edit of the scene, made for an eye, after the edit."""
    dataset = Dataset(data)
    scene = EditedScene.open(dataset, SCENE, "ideal", truth=False)
    eye, target = framed(scene.bounds, scene.view.world_from_camera.xyz - scene.bounds.mean(0), WIDTH / HEIGHT)
    film = make(Eye(look_at(eye, target), FIELD, WIDTH / HEIGHT))
    with TemporaryDirectory() as folder:
        log = EventLog(Path(folder), Header(dataset.id, SCENE, "ideal", False, SNAP, "scene"))
        asker = AtOnce(Method(SNAP, dataset.root, SCENE, "ideal", truth=False))
        editor = Controller(scene, film, log, asker)  # type: ignore[arg-type]
        asker.start(editor.received)
        for part in scene.parts:
            asker.ask(part, None)
        _edit(editor, film)
    return film


def _edit(editor: Controller, film: Recording) -> None:
    """The first part by hand, the others at once."""
    scene = editor.space.scene
    part = scene.parts[0]
    goal = goal_of(scene, part)
    film.take("Parts and kits, as one depth image shows them", 2500)
    grabbed = scene.pivot(part)
    plate = editor.space.pointing.below(goal.apply(grabbed))
    start, end = (film.eye.screen(point) for point in (grabbed, plate.projected(goal.apply(grabbed)) + OFF))
    editor.grab(part, film.eye, start, grabbed)
    for step in range(STEPS + 1):
        share = step / STEPS
        at = (start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1]))
        editor.drag(at)
        film.take("Drag a part roughly onto its cavity", 180, at)
    editor.release()
    film.take("The ghost: where it fits, and how sure that is", 3000, end)
    editor.command("take")
    film.take("Space takes it", 1500)
    editor.command("confirm")
    film.take("Enter confirms it", 1500)
    editor.command("take-all")
    editor.command("deselect")
    film.take("Shift+Space snaps all parts that are likely", 2500)
    editor.command("confirm-all")
    film.take("Shift+Enter confirms them: predictions.csv is written", 3500)


def goal_of(scene: EditedScene, part: int) -> Pose:
    """goal_from_now of a part: what a person sees, and the page does not know."""
    truth = scene.dataset.recorded_scene(scene.recorded.id, truth=True)
    return next(truth.truth_of(q.id).goal_drawn for q in truth.queries if q.part == part and q.track == "snap")


def _worded(label: str) -> str:
    """A label of the page with words for its marks."""
    for mark, word in WORDS.items():
        label = label.replace(mark, word)
    return label


def _write(draw: ImageDraw.ImageDraw, at: tuple[float, float], text: str) -> None:
    """A label above a place [px]."""
    font = ImageFont.load_default(size=13)
    left, top, right, bottom = draw.textbbox(at, text, font=font, anchor="mb")
    draw.rectangle((left - 3, top - 2, right + 3, bottom + 2), fill="white")
    draw.text(at, text, fill=INK, font=font, anchor="mb")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
