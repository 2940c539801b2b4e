"""What an import found, as text: sizes that a ruler can check, and notes about what makes fits unsure."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kit1000.capture.known_sensors import measures_time_of_flight
from kit1000.capture.own_scene import UNKNOWN_DEVICE, OwnScene
from kit1000.capture.seen_bodies import SeenBody

MUCH_RIPPLE = 2e-3  # [m] from which on fits are unsure
MOST_LISTED = 12  # bodies
UNUSUAL_OFF_CENTRE = 0.15  # of the image's sides, from its middle to the principal point


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
        yield "  note: no line separates the kit from all parts: move them apart; masks by networks are left out"


def body_text(body: SeenBody) -> str:
    """Area and sizes of a body."""
    short, long = (1e3 * side for side in body.sides)
    return f"{1e4 * body.area:.1f} cm² from above, {short:.0f} x {long:.0f} x {1e3 * body.height:.0f} mm"


def _middle(scene: OwnScene, body: SeenBody) -> str:
    """Where the recorded image shows a body, from its left and its top."""
    across, down = (np.median(places) / scene.table.image.enlarged for places in np.nonzero(body.mask)[::-1])
    return f"at {across:.0f}, {down:.0f} px"


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
