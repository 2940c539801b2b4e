"""Contact sheets of a dataset: what a person looks at before trusting it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image

from kit1000.data.geometry import Geometry
from kit1000.data.reader import Dataset, Recorded
from kit1000.errors import InputError
from kit1000.sim.depth_pictures import depth_picture, mask_picture
from kit1000.sim.pictures import KIT, PART, SECONDARY, Painted, shaded
from kit1000.sim.preview import assembly_tile, kit_tile, part_tile, sheet
from kit1000.values import View

SCENE_TILE = (960, 540)  # [px] one picture of a scene
ASKED = "snap-tilt"  # the track whose guesses are drawn: every preset has it


def contact_sheet_of(geometry: Geometry, what: str, split: str, count: int, ids: Sequence[str] = ()) -> bytes:
    """A PNG of parts, kits or assemblies: the given ids, or `count` spread evenly over a split."""
    rows = getattr(geometry, what)
    chosen = list(ids) or _spread(sorted(i for i, row in rows.items() if row["split"] == split), count)
    if not chosen:
        raise InputError(f"{geometry.root}: no {what} in split {split!r}")
    return sheet([_tile(geometry, what, item_id) for item_id in chosen], [_label(geometry, what, i) for i in chosen])


def scene_sheet(dataset: Dataset, scene_id: str) -> bytes:
    """A PNG of one scene: what the sensors see and the masks; where the truth is at hand, the scene, its goals and a
    guess beside them.
    """
    recorded = dataset.recorded(scene_id)
    view = recorded.view("ideal")
    tiles = {"ideal depth": depth_picture(view), "masks": mask_picture(recorded.look())}
    if "d415" in recorded.sensors:
        tiles["d415 depth"] = depth_picture(recorded.view("d415"))
    if recorded.split.truth:
        tiles |= _true_tiles(recorded, view)
    pictures = [Image.fromarray(tile).resize(SCENE_TILE, Image.Resampling.LANCZOS) for tile in tiles.values()]
    return sheet(pictures, [f"{scene_id}  {name}" for name in tiles], columns=2)


def _true_tiles(recorded: Recorded, view: View) -> dict[str, np.ndarray]:
    """The scene as it stands, with its parts seated, and with the drawn target as a person guesses it."""
    _, (assembly, world_from_assembly), *parts = recorded.bodies()
    kits = Painted(assembly, world_from_assembly, KIT)
    colours = [(PART, *SECONDARY)[i % 7] for i in range(len(parts))]
    lying = [Painted(mesh, pose, colour) for (mesh, pose), colour in zip(parts, colours, strict=True)]
    truths = {query.part: (query, recorded.truths[query.id]) for query in recorded.queries if query.track == ASKED}
    seated, guessed = list(lying), list(lying)
    for i, (query, truth) in truths.items():
        seated[i] = Painted(parts[i][0], truth.goal_drawn @ parts[i][1], colours[i])
        if query.guess is not None:
            guessed[i] = Painted(parts[i][0], query.guess @ parts[i][1], colours[i])
    camera = view.camera.scaled(SCENE_TILE[0] / view.camera.width)
    drawn = {"the scene": lying, "the goals of what is asked": seated, "as a person guesses": guessed}
    return {name: shaded([kits, *bodies], camera, view.world_from_camera) for name, bodies in drawn.items()}


def _spread(ids: list[str], count: int) -> list[str]:
    return [ids[i] for i in np.unique(np.linspace(0, len(ids) - 1, count).round().astype(int))] if ids else []


def _tile(geometry: Geometry, what: str, item_id: str) -> np.ndarray:
    if what == "parts":
        return part_tile(geometry.part(item_id))
    if what == "kits":
        return kit_tile(geometry.part(item_id), geometry.kit(item_id))
    assembly = geometry.assembly(item_id)
    return assembly_tile(assembly, {m.kit.id: geometry.part(m.kit.id) for m in assembly.mounts})


def _label(geometry: Geometry, what: str, item_id: str) -> str:
    if what == "assemblies":
        return f"{item_id}  {len(geometry.assemblies[item_id]['mounts'])} kits"
    return f"{item_id}  {geometry.parts[item_id]['family']}"
