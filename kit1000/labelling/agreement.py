"""How well a shape at a pose explains an image: the pixels of its outline and mask, and the differences of depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.labelling.alignment import PlacedShape
from kit1000.labelling.standing_plane import Support
from kit1000.pose import Pose
from kit1000.sim.render import render

REACH = 6.0  # standard deviations of depth at which a difference counts as much as none at all
LEAST_REACH = 3e-3  # [m]
WIDE = 3.0  # [px] beyond its width, by which a mask may end elsewhere than the outline
GOOD_COST, GOOD_OUTLINE, GOOD_DEPTH, GOOD_STRAY = 0.35, 2.5, 2.0, 0.08


@dataclass(frozen=True)
class Agreement:
    """How well a pose explains the image."""

    cost: float
    """0 where all pixels are explained, 1 where none is."""
    depth: float
    """[m] median absolute difference of measured and rendered depth."""
    noise: float
    """[m] standard deviation of depths at its distance, as the table shows it."""
    outline: float
    """[px] median distance of the outlines, beyond the width by which the mask is too wide."""
    stray: float
    """Share of the pixels of outline and mask that only one of the two has, beyond that width."""

    @property
    def faults(self) -> tuple[str, ...]:
        """In what the image disagrees with the pose more than its noise allows."""
        found = []
        if self.depth > GOOD_DEPTH * max(self.noise, LEAST_REACH / REACH):
            found.append(f"measured depths are {self.depth * 1e3:.1f} mm off, noise is {self.noise * 1e3:.1f} mm")
        if self.cost > GOOD_COST:
            found.append(f"only {1 - self.cost:.0%} of what is seen is explained")
        if self.outline > GOOD_OUTLINE:
            found.append(f"its outline is {self.outline:.1f} px off that of the mask")
        if self.stray > GOOD_STRAY:
            found.append(f"{self.stray:.0%} of its pixels are in the mask or the shape alone")
        return tuple(found)


def rendered_depth(placed: PlacedShape) -> np.ndarray:
    """(h, w) [m] depths of a shape in its window, 0 where it is not seen."""
    body = [(placed.mesh, placed.camera_from_body)]
    return render(placed.seen.camera, Pose.identity(), body, threads=1).depth.astype(float)


def agreement(placed: PlacedShape, support: Support, scale: float = 1.0) -> Agreement:
    """The agreement of a shape at its pose. scale: measured over true depth."""
    seen, shown = placed.seen, rendered_depth(placed)
    inside, open_ = shown > 0, ~seen.others
    both = inside & seen.mask & (seen.depth > 0)
    noise = float(support.noise_at(float(np.median(shown[inside])))) if inside.any() else np.inf
    reach = max(REACH * noise, LEAST_REACH)
    off = np.abs(seen.depth / scale - shown)
    cost = np.where(inside & seen.mask, 0.0, 1.0)
    cost[both] = np.minimum(off[both] / reach, 1.0)
    either = (inside | seen.mask) & open_
    beyond = np.abs(seen.distance + placed.width)
    stray = either & (inside != seen.mask) & (beyond > WIDE)
    border = inside & open_ & _is_border(inside)
    return Agreement(
        cost=float(cost[either].mean()) if either.any() else 1.0,
        depth=float(np.median(off[both])) if both.any() else np.inf,
        noise=noise,
        outline=float(np.median(beyond[border])) if border.any() else np.inf,
        stray=float(stray.sum() / max(either.sum(), 1)),
    )


def _is_border(inside: np.ndarray) -> np.ndarray:
    """The pixels of a shape (h, w) bool with a neighbour outside it."""
    padded = np.pad(inside, 1)
    return inside & ~(padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:])
