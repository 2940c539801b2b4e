"""Masks with the outlines that segmentation sees: by networks, or by rules for a structured-light scanner.

Bodies are found by their height over the ripple of the table, which leaves out their feet and narrow edges; networks
have learned where bodies end. Simulated images of val, 1 mm PNG: IoU of parts 0.80 by height, 0.89 by networks, and
unknown shapes seated 29 of 111, by height 22.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation, binary_propagation, find_objects

from kit1000.capture.own_world import world_of_bodies
from kit1000.capture.seen_bodies import EDGE, FRAGMENT, SeenBody, lies_within, measured_body
from kit1000.capture.table_search import Table, convex_outline, inside_outline
from kit1000.perception.segmentation.instances import find_bodies, segmented
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.values import ASSEMBLY_LABEL, View

AGREED = 0.5  # least IoU of a body and what the network sees of it; least share of a body that lies in one instance
LOW_PIXELS, LOW_LOGIT = 250, 1.5  # least size [px] and mean logit of an instance that no body covers
LOW_COVERED = 0.3  # share of such an instance that bodies cover, at most
LOW_STEP, RING = 1.5e-3, (5, 14)  # [m] by which it is higher than the table about it, [px] how far away that is
LEAST_PART = 150  # [px] of an instance
LEAST_SHARE = 0.12  # ratio of the pixels of an instance to those of the largest one in a body, at least
ROUND = 0.88  # area over convex area from above: a body with more than that is one part
CELL = 2e-3  # [m] side of the cells of the table by which areas are measured
LONGEST = 0.25  # [m] of bodies that may be several parts: five of 50 mm, as the networks know them


class Found(NamedTuple):
    """What segmentation sees."""

    kits: np.ndarray  # (H, W) bool
    instances: np.ndarray  # (H, W) int: from 1 on the parts of the parts' half, 0 elsewhere
    logits: np.ndarray  # (H, W) of showing a part, by a network; 0 if none looked


def networks_available() -> bool:
    """Whether torch is there, with which the networks run."""
    return find_spec("torch") is not None and find_spec("safetensors") is not None


def outlined(
    table: Table, depth: np.ndarray, bodies: Sequence[SeenBody], doubtful: Sequence[SeenBody], facts: SensorFacts
) -> tuple[SeenBody, list[SeenBody]]:
    """The kit and the parts with the outlines that the networks see.

    Touching parts become several, and bodies of one part become one. A small body that no line separates from the kit
    joins the kit if it is a piece of it, which a shadow cut off; beside a larger one all bodies stay as they are.

    Args:
        table: of the image.
        depth: (H, W) float32 [m] on the grid of recordings.
        bodies: the kit first.
        doubtful: bodies that tell where the parts are if there are no others.
        facts: about the sensor.
    """
    kit, *parts = bodies
    world = world_of_bodies(table, kit, parts or doubtful)
    between = [body for body in parts or doubtful if body not in world.beside]
    if not world.beside or any(body.area > FRAGMENT * kit.area for body in between):
        return kit, parts  # the networks know scenes in two halves
    found = _found(View(table.image.camera, world.world_from_camera, depth), facts)
    kits = np.asarray(binary_propagation(kit.mask & found.kits, mask=found.kits), bool)  # without specks beside them
    cut_off = [body for body in between if _is_cut_off(table, body, kit, kits)]
    if cut_off:
        kit = measured_body(table, np.any([body.mask for body in (kit, *cut_off)], axis=0))
    parts = [part for part in parts if part not in cut_off]
    whole = _joined(table, parts + _low_parts(table, bodies, found), found)
    counts = _instance_counts(whole, found.instances)
    pieces = [_pieces(table, *counted, found.instances) for counted in zip(whole, counts, strict=True)]
    return _with_outline(table, kit, kits), [piece for some in pieces for piece in some]


def _is_cut_off(table: Table, body: SeenBody, kit: SeenBody, kits: np.ndarray) -> bool:
    """Whether a body is a piece of the kit, whose outline (H, W) bool segmentation sees."""
    return bool(np.mean(kits[body.mask]) > AGREED) and lies_within(table, body, kit)


def _found(view: View, facts: SensorFacts) -> Found:
    """What the networks see; for a scanner, whose images no network restores, what the rules see."""
    if not facts.kind.restores:
        labels = segmented(view, facts)
        parts = np.maximum(labels.astype(int) - ASSEMBLY_LABEL, 0)
        return Found(labels == ASSEMBLY_LABEL, parts, np.zeros(labels.shape))
    from kit1000.perception.segmentation.predicted_masks import mask_networks

    restorer, finder = mask_networks()
    bodies = find_bodies(view, facts, restorer)
    return Found(bodies.kits, *finder.instances(bodies))


def _low_parts(table: Table, bodies: Sequence[SeenBody], found: Found) -> list[SeenBody]:
    """The instances that no body covers: parts that the ripple of the table hides, but not from the networks.

    Pixels without a return count with a logit of 0, for a network guesses there.
    """
    pixels = np.bincount(found.instances.ravel())
    covered = np.bincount(found.instances[np.any([body.mask for body in bodies], axis=0)], minlength=len(pixels))
    logits = np.where(table.image.depth > 0, found.logits, 0.0)
    likely = np.bincount(found.instances.ravel(), logits.ravel()) > LOW_LOGIT * pixels
    low = likely & (pixels >= LOW_PIXELS) & (covered < LOW_COVERED * pixels)
    boxes = find_objects(found.instances)
    numbers = [number for number in np.flatnonzero(low).tolist() if number]
    standing = [number for number in numbers if _stands_on_table(table, found.instances, number, boxes[number - 1])]
    return [measured_body(table, found.instances == number) for number in standing]


def _stands_on_table(table: Table, instances: np.ndarray, number: int, sides: tuple[slice, slice]) -> bool:
    """Whether an instance is inside the outline of the table, and higher than what is about it.

    The level about it is taken as at most one ripple below the plane of the table, also if nothing returned there.

    Args:
        table: of the image.
        instances: (H, W) int.
        number: of the instance.
        sides: the box about it.
    """
    shown, heights = (instances == number) & (table.image.depth > 0), table.flat_heights
    if not shown.any() or np.mean(inside_outline(table.ground(shown), table.outline, EDGE)) < AGREED:
        return False
    box = tuple(slice(max(side.start - RING[1], 0), side.stop + RING[1]) for side in sides)
    near, far = (np.asarray(binary_dilation(instances[box] == number, iterations=reach), bool) for reach in RING)
    about = heights[box][far & ~near & (instances[box] == 0) & (table.image.depth[box] > 0)]
    level = max(float(np.median(about)), -table.ripple) if len(about) else -table.ripple
    return bool(np.mean(heights[shown]) > level + LOW_STEP)


def _joined(table: Table, parts: Sequence[SeenBody], found: Found) -> list[SeenBody]:
    """The parts in their order; parts that segmentation sees as one instance are joined, up to LONGEST."""
    whole: dict[int, SeenBody] = {}
    for place, part in enumerate(parts):
        counts = np.bincount(found.instances[part.mask], minlength=2)
        number = int(counts[1:].argmax()) + 1
        name = number if counts[number] > AGREED * part.mask.sum() else -place
        both = measured_body(table, whole[name].mask | part.mask) if name in whole else part
        small = both.sides[1] < LONGEST
        whole[name if small else -place] = both if small else part
    return list(whole.values())


def _with_outline(table: Table, body: SeenBody, seen: np.ndarray) -> SeenBody:
    """A body with the outline that segmentation sees (H, W) bool; unchanged if both disagree too much."""
    agree = (body.mask & seen).sum() > AGREED * (body.mask | seen).sum()
    return measured_body(table, seen) if agree and (table.image.depth[seen] > 0).any() else body


def _instance_counts(parts: Sequence[SeenBody], instances: np.ndarray) -> np.ndarray:
    """(k, n) the pixels of each instance in each part; 0 but for the part that shows most of it. instances: (H, W)."""
    size = instances.max() + 1
    counts = np.array([np.bincount(instances[part.mask], minlength=size) for part in parts]).reshape(-1, size)
    return np.where((counts == counts.max(0, initial=1)) & (np.arange(size) > 0), counts, 0)


def _pieces(table: Table, body: SeenBody, counts: np.ndarray, instances: np.ndarray) -> list[SeenBody]:
    """The parts that a body consists of, the largest first; one if its outline is that of a single part.

    counts: (n,) its pixels in each of the instances (H, W).
    """
    numbers = np.flatnonzero(counts >= max(LEAST_PART, LEAST_SHARE * counts.max()))
    if len(numbers) < 2 or body.sides[1] > LONGEST or _roundness(table, body) > ROUND:
        return [_with_outline(table, body, np.isin(instances, numbers))]
    masks = [instances == number for number in numbers]
    masks = [mask for mask in masks if (table.image.depth[mask] > 0).any()]
    return sorted((measured_body(table, mask) for mask in masks), key=lambda piece: -piece.area)


def _roundness(table: Table, body: SeenBody) -> float:
    """The area of the cells of the table that a body covers over that of its convex outline, both from above."""
    outline = convex_outline(table.ground(body.mask))
    if len(outline) == 0:
        return 1.0
    x, y = outline.T
    convex = float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)
    cells = np.unique(np.floor(table.ground(body.mask) / CELL).astype(int), axis=0)
    return len(cells) * CELL**2 / max(convex, 1e-9)
