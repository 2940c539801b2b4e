"""Fresh kits to learn completion from: a plate of an assembly of the train split gives way to one cut for a fresh part.

Kit i of a seed is the same whoever makes it.
"""

from __future__ import annotations

import numpy as np

from baselines.completion.drawn_parts import DrawnPart, drawn_part
from kit1000.errors import InputError, Redraw
from kit1000.kits.assembly import join_mounts
from kit1000.kits.cavity import MIN_SEATED_HEIGHT
from kit1000.kits.face import RestingFace
from kit1000.kits.kit import design_kit
from kit1000.parts.family import part_of_mesh
from kit1000.products import matmul
from kit1000.rng import stream
from kit1000.values import Assembly, Kit, Mount

MAX_DRAWS = 50  # of one kit


def drawn_kit(seed: int, index: int) -> Kit:
    """Kit number `index` of a seed: the first of its draws whose part fits a plate of datasets."""
    for attempt in range(MAX_DRAWS):
        part = drawn_part(seed, MAX_DRAWS * index + attempt)
        face = _insertion_face(part, stream(seed, "completion-kit", index, attempt))
        if face.height < MIN_SEATED_HEIGHT:
            continue
        try:
            return design_kit(part_of_mesh("drawn", part.mesh), face=face).kit
        except Redraw:
            continue
    raise InputError(f"kit {index} of seed {seed}: none of {MAX_DRAWS} draws is a kit")


def with_kit(assembly: Assembly, number: int, kit: Kit) -> Assembly:
    """The assembly with another kit in one of its mounts. Raises Redraw when its mesh is unprintable."""
    mounts = list(assembly.mounts)
    mounts[number] = Mount(kit, mounts[number].assembly_from_kit)
    return join_mounts(assembly.id, tuple(mounts))


def _insertion_face(part: DrawnPart, rng: np.random.Generator) -> RestingFace:
    """One of the faces on which a part rests, as often as it rests on it."""
    number = int(rng.choice(len(part.down), p=part.probability))
    along = matmul(part.mesh.vertices, part.down[number])
    return RestingFace(part.down[number], float(part.probability[number]), float(np.ptp(along)))
