"""Hand control, the paper's interface beside scene editing: two suction cups over points, one part at a time.

The hand moves the robot's cup and not the parts. The cup is shown twice: green where it picks a part, yellow where it
releases the part. The motion of the part follows from both. Confirming carries the part, and both cups return. Two
variants:

- `hand`: cups have the aids of editing: they slide on surfaces, align with the plate's normal and obey the same keys.
- `hand-bare`: as in the paper, cups move by a gizmo alone.

Nothing snaps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from kit1000.editor.pointing import Eye, Support, Surface, SurfaceImage
from kit1000.editor.scene import EditedScene
from kit1000.editor.seen_plates import TABLE, Plate
from kit1000.editor.session import UNTOUCHED, PartEdit, part_name
from kit1000.editor.workspace import Step, Workspace
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.parts.cad import box, cone, cylinder
from kit1000.pose import Pose

PICK, PLACE = -1, -2
"""The cups as bodies of a session, beside the parts."""
NAMES = {PICK: "green cup", PLACE: "yellow cup"}
ASIDE = 0.03  # [m] of the cups from parts and kits, before they are moved
REACH = 10e-3  # [m] from the lip to the nearest seen point of the part that is picked
BESIDE = 3e-3  # [m] from the lip across to seen points that are below it
DOWN = Pose.from_rotvec((np.pi, 0.0, 0.0))
"""world_from_cup, with +z out of the cup."""


def cup_mesh() -> Mesh:
    """A suction cup in its frame [m]: +z out of the lip, a fin in +x, by which one sees how it is turned."""
    lip = cone(7.0, 12.0, 6.0).translate((0, 0, -6))
    tube, fin = cylinder(7.0, 60.0).translate((0, 0, -66)), box(16.0, 3.0, 8.0).translate((8, 0, -40))
    return mesh_from_solid(lip + tube + fin).scaled(1e-3)


class Tops:
    """The surface of the parts as seen, on which the picking cup is put, upright."""

    def __init__(self, tops: Mapping[int, np.ndarray], image: SurfaceImage) -> None:
        """tops: (n, 3) [m] seen points by part, where they are now. image: of the parts, the table and the kits."""
        self.tops, self.image = tops, image

    def support(self, eye: Eye, screen: tuple[float, float]) -> Support | None:
        """The place under the cursor: level, whatever is there."""
        point = self.image.seen(eye, screen)
        return None if point is None else Support(point, _level(point))

    def below(self, point: np.ndarray) -> Plate:
        """The level plane of the highest seen point below a cup at a point (3,) [m]; the table if there is none."""
        points = np.concatenate([*self.tops.values(), np.zeros((0, 3))])
        under = points[np.square(points[:, :2] - point[:2]).sum(1) < BESIDE**2]
        return _level(under[under[:, 2].argmax()]) if len(under) else TABLE

    def nearest(self, point: np.ndarray) -> int | None:
        """The part under a cup with its lip at a point (3,) [m]; None if it reaches none."""
        distances = {part: float(np.square(points - point).sum(1).min()) for part, points in self.tops.items()}
        part = min(distances, key=lambda part: distances[part], default=None)
        return part if part is not None and distances[part] < REACH**2 else None


class HandWorkspace(Workspace):
    """The state of an editor in which the hand moves two cups."""

    interface = "hand"

    def __init__(self, scene: EditedScene, snaps: bool = False) -> None:
        """Both cups stand on the table, beside the parts and beside the kits. snaps: ignored, nothing does."""
        super().__init__(scene, snaps=False)
        parts = np.concatenate([scene.clouds[part] for part in scene.parts])
        self._rest = {
            cup: Pose(DOWN.wxyz, np.array([points[:, 0].max() + ASIDE, _middle(points)[1], 0.0]))
            for cup, points in ((PICK, parts), (PLACE, scene.kits.vertices))
        }
        self._known: tuple[tuple[PartEdit, ...], Tops, int | None] | None = None

    @property
    def bodies(self) -> tuple[int, ...]:
        """The cups."""
        return PICK, PLACE

    @property
    def edited(self) -> tuple[int, ...]:
        """The parts, which confirming moves, and the cups."""
        return (*self.scene.parts, *self.bodies)

    def name(self, body: int) -> str:
        """What the page calls a body."""
        return NAMES.get(body) or part_name(body)

    def rest(self, body: int) -> Pose:
        """world_from_cup before it is moved."""
        return self._rest[body]

    def pivot(self, body: int) -> np.ndarray:
        """(3,) [m] world: the middle of the cup's lip."""
        return self._rest[body].xyz if body in NAMES else super().pivot(body)

    def cloud(self, body: int) -> np.ndarray:
        """(n, 3) [m] world: the lip; below the placing cup also the part that hangs from it."""
        if body not in NAMES:
            return super().cloud(body)
        lip, part = self.pivot(body)[None], self.carried(body)
        return lip if part is None else np.concatenate([lip, self._hung(part).apply(self.scene.clouds[part])])

    def surface(self, body: int) -> Surface:
        """The picking cup is put on parts, the placing cup on plates and table."""
        return self._tops()[0] if body == PICK else self.pointing

    def carried(self, body: int) -> int | None:
        """The part under the picking cup, which the placing cup lets go."""
        return self._tops()[1] if body == PLACE else None

    def part_edit(self, body: int) -> PartEdit:
        """The edit of the part if the cup releases it here."""
        part, edit = self.carried(body), self.current[body]
        assert part is not None
        return PartEdit(edit.goal_from_now @ self._hung(part), turned=edit.turned or self.current[PICK].turned)

    def over_kits(self, body: int) -> bool:
        """Whether the placing cup has been moved over a plate."""
        return not self.current[body].same_as(UNTOUCHED) and super().over_kits(body)

    def pointed_at(self, part: int) -> tuple[int, Step]:
        """The picking cup stands on the part's seen point nearest to its middle."""
        points = self._tops()[0].tops[part]
        image = self.current[part].goal_from_now.apply(self.scene.pivot(part))
        point = points[np.square(points[:, :2] - image[:2]).sum(1).argmin()]
        edit = UNTOUCHED.moved(Pose.from_translation(point - self._rest[PICK].xyz))
        return PLACE, Step(f"{NAMES[PICK]} to {part_name(part)}", {PICK: edit})

    def confirmed(self, bodies: Sequence[int]) -> Step | None:
        """The part is carried from the picking cup to the placing cup, and both are back."""
        del bodies
        part = self.carried(PLACE)
        if part is None or not self.over_kits(PLACE):
            return None
        edits = {part: self.part_edit(PLACE).confirm(), **self.put_back(self.bodies)}
        return Step(f"carry {part_name(part)}", edits)

    def _hung(self, part: int) -> Pose:
        """The motion of a part from its recorded pose to below the placing cup at rest."""
        world_from_pick = self.current[PICK].goal_from_now @ self._rest[PICK]
        return self._rest[PLACE] @ world_from_pick.inverse() @ self.current[part].goal_from_now

    def _tops(self) -> tuple[Tops, int | None]:
        """The parts where they are now, and the one under the picking cup; computed again if either has moved."""
        edits = tuple(self.current[body] for body in (*self.scene.parts, PICK))
        known = self._known
        if known is not None and all(one is other for one, other in zip(edits, known[0], strict=True)):
            return known[1:]
        if known is not None and all(one is other for one, other in zip(edits[:-1], known[0][:-1], strict=True)):
            tops = known[1]
        else:
            motions = {part: self.current[part].goal_from_now for part in self.scene.parts}
            seen = {part: motion.apply(self.scene.tops[part]) for part, motion in motions.items()}
            bodies = [(self.scene.meshes[part], motion) for part, motion in motions.items()]
            tops = Tops(seen, SurfaceImage([(self.scene.kits, Pose.identity()), *bodies]))
        self._known = edits, tops, tops.nearest(self.current[PICK].goal_from_now.apply(self._rest[PICK].xyz))
        return self._known[1:]


class BareHandWorkspace(HandWorkspace):
    """Hand control as in the paper: gizmos alone."""

    interface = "hand-bare"
    assists = False

    def __init__(self, scene: EditedScene, snaps: bool = False) -> None:
        """The gizmo is shown."""
        super().__init__(scene, snaps)
        self.shows_gizmo = True


def _level(point: np.ndarray) -> Plate:
    """A level plane through a point (3,) [m]."""
    return Plate(TABLE.normal, point, 0.0)


def _middle(points: np.ndarray) -> np.ndarray:
    """(3,) [m] of the extents of points (n, 3)."""
    return (points.min(0) + points.max(0)) / 2
