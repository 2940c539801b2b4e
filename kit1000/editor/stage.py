"""What the editor asks of a page: eleven verbs. `page` answers them with viser; tests answer them with a list."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from kit1000.mesh import Mesh
from kit1000.pose import Pose

Colour = tuple[int, int, int]


class Stage(Protocol):
    """A page with a scene and a panel."""

    def show(self, name: str, mesh: Mesh, colour: Colour, opacity: float | None, /) -> None:
        """Add a mesh [m] of the world, at rest; None: opaque."""
        ...

    def dots(self, name: str, points: np.ndarray, colours: np.ndarray, /) -> None:
        """Add points (n, 3) [m] of the world, at rest, in colours (n, 3) uint8."""
        ...

    def move(self, name: str, motion: Pose, /) -> None:
        """Move a mesh or points by a motion of the world from where they were added."""
        ...

    def look(self, name: str, /, colour: Colour | None = None, visible: bool | None = None) -> None:
        """Change the colour of a mesh; hide or show a mesh or points."""
        ...

    def label(self, name: str, text: str, point: ArrayLike, /) -> None:
        """Write at a point (3,) [m] of the world; an empty text removes the label."""
        ...

    def say(self, place: str, text: str, /) -> None:
        """Write Markdown into a place of the panel: head, parts, fit or note."""
        ...

    def progress(self, share: float, /) -> None:
        """How much of the background work is done, 0 to 1."""
        ...

    def history(self, names: Sequence[str], done: int, /) -> None:
        """List the operations, done and undone; the first `done` of them are done."""
        ...

    def gizmo(self, pose: Pose | None, /) -> None:
        """Show the gizmo at a pose, or hide it."""
        ...

    def look_from(self, eye: ArrayLike, target: ArrayLike, /) -> None:
        """Put the camera to a point (3,) [m], looking at another."""
        ...

    def flush(self) -> None:
        """Send all this now."""
        ...
