"""Fresh kits to learn completion from: a plate of an assembly of the train split gives way to one cut for a fresh part.

Kit i of a seed is the same whoever makes it. Stretched, it shows the network yet another cavity.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from baselines.training.tasks.part_completion.sampled_parts import DrawnPart, drawn_part
from kit1000.errors import InputError, Redraw
from kit1000.kits.assembly import join_mounts
from kit1000.kits.cavity import MIN_SEATED_HEIGHT
from kit1000.kits.face import RestingFace
from kit1000.kits.kit import design_kit
from kit1000.mesh import Mesh
from kit1000.numerics.linear_algebra import matmul
from kit1000.parts.family import part_of_mesh
from kit1000.rng import stream
from kit1000.values import Assembly, Kit, Mount

MAX_DRAWS = 50  # of one kit
STRETCH = np.array([(0.75, 1.1), (0.75, 1.1), (0.7, 1.05)])
"""Range of `stretched`'s factors in x, y and z: a cavity of 20 mm keeps 1 mm of floor, and gaps between plates stay."""
UNDERSIDE = 1e-6  # [m] above it, vertices are the cavity's or the face's


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


def stretched(kit: Kit, factors: np.ndarray) -> Kit:
    """The kit with its plate stretched along x and y, and along z its cavity alone: the plate keeps its thickness.

    Its slot is still that of the part before. factors: (3,), those of x, y and z. Raises InputError when the cavity
    would reach the plate's underside.
    """
    lowest = UNDERSIDE - kit.extent[2]
    above = kit.mesh.vertices[:, 2] > lowest
    vertices = kit.mesh.vertices * (*factors[:2], 1.0)
    vertices[above, 2] *= factors[2]
    if vertices[above, 2].min() <= lowest:
        raise InputError(f"factors: {factors[2]} along z stretches the cavity through the plate's underside")
    return replace(kit, mesh=Mesh(vertices, kit.mesh.faces), extent=kit.extent * (*factors[:2], 1.0))


def _insertion_face(part: DrawnPart, rng: np.random.Generator) -> RestingFace:
    """One of the faces on which a part rests, as often as it rests on it."""
    number = int(rng.choice(len(part.down), p=part.probability))
    along = matmul(part.mesh.vertices, part.down[number])
    return RestingFace(part.down[number], float(part.probability[number]), float(np.ptp(along)))
