"""The solid of a file some of whose volumes are subtracted, as a slicer does it."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from kit1000.errors import MeshRefused
from kit1000.parts.files.repair import closed_solid
from kit1000.parts.files.soup import Cut, TriangleSoup
from kit1000.parts.files.united_bodies import united


def solid_of_soup(soup: TriangleSoup, notes: list[str]) -> Manifold:
    """The solid that a soup in metres bounds; a note of each repair is appended to `notes`.

    Raises:
        MeshRefused: with the reason and its count.
    """
    if not soup.cuts:
        return closed_solid(soup.vertices, soup.faces, notes)
    solids = [closed_solid(soup.vertices, soup.faces, notes)] if len(soup.faces) else []
    solids += [_difference(soup.vertices, cut, notes) for cut in soup.cuts]
    left = [solid for solid in solids if not solid.is_empty()]
    if not left:
        raise MeshRefused("nothing is left of it once its negative volumes are subtracted")
    return Manifold.compose(left) if len(left) > 1 else left[0]


def _difference(vertices: np.ndarray, cut: Cut, notes: list[str]) -> Manifold:
    """The parts without the negative volumes after them, each run united first: its volumes may overlap."""
    solid = Manifold()
    for number, faces in enumerate(cut.runs):
        if number % 2 == 0:
            part = united(closed_solid(vertices, faces, notes), [])
            solid = solid + part if number else part
        else:
            solid -= _negative(vertices, faces)
    return solid


def _negative(vertices: np.ndarray, faces: np.ndarray) -> Manifold:
    try:
        return united(closed_solid(vertices, faces, []), [])
    except MeshRefused as refused:
        raise MeshRefused(f"a negative volume is {refused.reason}") from None
