"""What an import found, as text: sizes that a ruler can check, and notes about what makes fits unsure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from kit1000.capture.known_sensors import measures_time_of_flight
from kit1000.capture.own_scene import UNKNOWN_DEVICE, OwnScene
from kit1000.capture.seen_bodies import SeenBody
from kit1000.errors import InputError

MUCH_RIPPLE = 2e-3  # [m] from which on fits are unsure
MOST_LISTED = 12  # bodies
UNUSUAL_OFF_CENTRE = 0.15  # of the image's sides, from its middle to the principal point
SAME_SIZE = 0.15  # by which a side of --check may differ, and
SAME_LENGTH = 6e-3  # [m] by which at least
SHORTEST, LONGEST = 1e-3, 2.0  # [m] of its sides


def report(scene: OwnScene, clearance: float | None) -> Iterator[str]:
    """The lines about a scene."""
    table, world, facts = scene.table, scene.world, scene.facts
    yield (
        f"{scene.source}: table {100 * table.share:.0f} % of the image, camera {100 * table.distance:.0f} cm above it, "
        f"seen {table.tilt_deg:.0f}° from straight above, ripple {1e3 * table.ripple:.1f} mm ({facts.noise_px:.2f} px)"
    )
    yield f"  intrinsics: {scene.intrinsics}" + (f"; 1 in the image is {1e3 * facts.unit:g} mm" if facts.unit else "")
    numbers = {id(body): n for n, body in enumerate(sorted(scene.bodies, key=lambda body: -body.area), start=1)}
    for place, body in enumerate(scene.bodies[:MOST_LISTED]):
        name = "kit" if place == 0 else f"part {place - 1}, {place} on the page"
        yield f"  body {numbers[id(body)]}: {body_text(body):44s} {_middle(scene, body):17s} {name}"
    if len(scene.bodies) > MOST_LISTED:
        yield f"  and {len(scene.bodies) - MOST_LISTED} more"
    yield "  measure one of them with a ruler: wrong intrinsics or units show here"
    yield from (f"  note: {note}" for note in _notes(scene, clearance))
    if world.gap is not None and world.gap <= 0:
        yield "  note: no line separates the kit from all parts: move them apart; networks see at most one side"


def body_text(body: SeenBody) -> str:
    """Area and sizes of a body."""
    short, long = (1e3 * side for side in body.sides)
    return f"{1e4 * body.area:.1f} cm² from above, {short:.0f} x {long:.0f} x {1e3 * body.height:.0f} mm"


def _middle(scene: OwnScene, body: SeenBody) -> str:
    """Where the recorded image shows a body, from its left and its top."""
    across, down = (np.median(places) / scene.table.image.enlarged for places in np.nonzero(body.mask)[::-1])
    return f"at {across:.0f}, {down:.0f} px"


def check_sides(sides: Sequence[float]) -> None:
    """Raise InputError for sides [m] that no box on a table has."""
    if len(sides) != 3 or not all(SHORTEST <= side <= LONGEST for side in sides):
        given = " ".join(f"{1e3 * side:g}" for side in sides)
        raise InputError(f"--check {given}: expected the three sides of a box in view, in mm, each from 1 to 2000")


def check_size(scenes: Sequence[OwnScene], sides: Sequence[float]) -> str:
    """The body that a box of known sides (3,) [m] is, as a line.

    Raises InputError if no body has these sides: then intrinsics or units are wrong.
    """
    wanted = " x ".join(f"{1e3 * side:.0f}" for side in sides)
    best, closest = float("inf"), None
    for scene in scenes:
        for body in scene.bodies:
            off = _difference(body, sides)
            if off < best:
                best, closest = off, body
    assert closest is not None, "a scene has bodies"
    if best <= 1:
        return f"  check: a box of {wanted} mm is in view, measured {_measured(closest)}"
    ratio = (closest.sides[0] * closest.sides[1] * closest.height / (sides[0] * sides[1] * sides[2])) ** (1 / 3)
    raise InputError(
        f"--check {wanted}: no body in view has these sides; the nearest measures {_measured(closest)}, by {ratio:.2f} "
        "in length: are intrinsics and unit those of this stream?"
    )


def _difference(body: SeenBody, sides: Sequence[float]) -> float:
    """The largest difference between the sides of a body and those of a box standing on any face, 1: just allowed."""
    found = (*body.sides, body.height)
    stands = []
    for up in range(3):
        flat = sorted(side for i, side in enumerate(sides) if i != up)
        pairs = zip(found, (*flat, sides[up]), strict=True)
        stands.append(max(abs(seen - true) / max(SAME_SIZE * true, SAME_LENGTH) for seen, true in pairs))
    return min(stands)


def _measured(body: SeenBody) -> str:
    short, long = (1e3 * side for side in body.sides)
    return f"{short:.0f} x {long:.0f} x {1e3 * body.height:.0f} mm"


def _notes(scene: OwnScene, clearance: float | None) -> Iterator[str]:
    table, facts = scene.table, scene.facts
    if table.ripple > MUCH_RIPPLE:
        yield (
            f"ripple {1e3 * table.ripple:.1f} mm: fits will be unsure. Average 30 frames, come nearer than 0.7 m, "
            "avoid shiny white, raise the laser power"
        )
    camera = table.image.camera
    off = max(abs(camera.cx / camera.width - 0.5), abs(camera.cy / camera.height - 0.5))
    if off > UNUSUAL_OFF_CENTRE:
        yield (
            f"principal point {100 * off:.0f} % of the image from its middle: are the intrinsics of this size, or is "
            "the image cropped?"
        )
    if facts.scanner:
        yield f"{facts.device}: read as of a structured-light scanner, whose edges are sharp and whose holes stay"
    elif facts.device == UNKNOWN_DEVICE:
        yield "no --device: read as of a stereo camera such as the D415"
    if facts.stream == "aligned":
        yield "taken as aligned to another camera; depth of the camera's own stream, with --stream raw, is more exact"
    if measures_time_of_flight(facts.device):
        yield f"{facts.device} measures time of flight, which blurs edges: not supported, fits will be off"
    if clearance is None:
        yield "no --clearance-mm: several gaps between part and cavity are tried"
    shift, tilt = scene.world.moved
    if abs(shift) > 1e-3 or tilt > 0.1:
        yield f"the given pose was corrected by {1e3 * shift:+.1f} mm in z and {tilt:.2f}°: the table is at z = 0"
