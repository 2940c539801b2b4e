"""The pictures of the README and the docs, rendered by the package: `make pictures`."""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from kit1000.dataset.reader import Dataset
from kit1000.errors import Redraw
from kit1000.generation.build import generate
from kit1000.generation.presets import PRESETS
from kit1000.kits.assembly import build_assembly, check_assembly, draw_assembly
from kit1000.kits.kit import make_kit
from kit1000.mesh import Mesh
from kit1000.parts.family import make_part
from kit1000.parts.family_catalog import FAMILIES
from kit1000.pictures.dataset_sheets import scene_sheet
from kit1000.pictures.shading import KIT, PART, ColouredBody, contact_sheet, framing_camera, shaded_picture
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.values import Assembly, Kit, Part

FOLDER = Path(__file__).parent
SEED = 1000
LONGEST = 50e-3  # [m] longest side of a part
SCENE, SCENE_WIDTH = "test-s0001", 1500  # [px]
HERO_FAMILIES = ("gear", "bracket", "lever", "clevis")  # of distinct shapes; the first is in the base
HOVER = (0.05, 0.035, 0.06, 0.0)  # [m] of each part above its goal, along the insertion axis; the last is seated
FRONT = (1.0, -1.6, 1.5)  # from the assembly to the camera


def main() -> None:
    """Write all pictures to the folder of this file."""
    hero(FOLDER / "hero.png")
    families(FOLDER / "families.png")
    scene(FOLDER / "scene.png")


def scene(path: Path) -> None:
    """The contact sheet of one scene of a dataset."""
    with TemporaryDirectory() as folder:
        generate(PRESETS["tiny"], Path(folder))
        sheet = Image.open(BytesIO(scene_sheet(Dataset(folder), SCENE)))
    sheet.thumbnail((SCENE_WIDTH, SCENE_WIDTH), Image.Resampling.LANCZOS)
    sheet.save(path, optimize=True)


def hero(path: Path) -> None:
    """Parts above the cavities of an angled assembly."""
    pairs = [next(pairs_of(name)) for name in HERO_FAMILIES]
    assembly = next(assemblies(pairs))
    bodies = [ColouredBody(assembly.mesh, Pose.identity(), KIT)]
    for (part, _), mount, height in zip(pairs, assembly.mounts, HOVER, strict=True):
        out = Pose.from_translation(np.array([0, 0, height]))
        bodies.append(ColouredBody(part.mesh, mount.assembly_from_kit @ out @ mount.kit.slot.kit_from_part, PART))
    save(picture(bodies, (1600, 900), FRONT), path)


def families(path: Path) -> None:
    """One part of every family."""
    parts = [next(parts_of(name)) for name in sorted(FAMILIES)]
    views = [picture([ColouredBody(standing(part.mesh), Pose.identity(), PART)], (280, 224)) for part in parts]
    contact_sheet(views, [part.family.replace("_", " ") for part in parts], columns=7).save(path, optimize=True)


def standing(mesh: Mesh) -> Mesh:
    """The mesh with its longest side along x and its shortest along z."""
    order = np.argsort(-mesh.extents, kind="stable")
    rotation = np.eye(3)[order]
    rotation[2] *= np.linalg.det(rotation)
    return mesh.moved(Pose.from_rotation_matrix(rotation))


def parts_of(family: str) -> Iterator[Part]:
    """Parts of a family, without redraws."""
    for number in range(100):
        try:
            yield make_part(family, family, FAMILIES[family].draw(stream(SEED, family, number)), LONGEST)
        except Redraw:
            continue


def pairs_of(family: str) -> Iterator[tuple[Part, Kit]]:
    """Parts of a family with their kits, without redraws."""
    for part in parts_of(family):
        try:
            yield part, make_kit(part)
        except Redraw:
            continue


def assemblies(pairs: list[tuple[Part, Kit]]) -> Iterator[Assembly]:
    """Assemblies of the kits that pass all checks."""
    parts = {part.id: part for part, _ in pairs}
    for number in range(100):
        try:
            plan = draw_assembly(stream(SEED, "hero", number), len(pairs))
            assembly = build_assembly("hero", [kit for _, kit in pairs], plan)
            check_assembly(assembly, parts)
            yield assembly
        except Redraw:
            continue


def picture(
    bodies: list[ColouredBody], size: tuple[int, int], direction: tuple[float, float, float] | None = None
) -> np.ndarray:
    """(H, W, 3) uint8: the bodies, as large as fits."""
    view = framing_camera(bodies, size=size) if direction is None else framing_camera(bodies, direction, size=size)
    return shaded_picture(bodies, *view)


def save(image: np.ndarray, path: Path) -> None:
    Image.fromarray(image).save(path, optimize=True)


if __name__ == "__main__":
    main()
