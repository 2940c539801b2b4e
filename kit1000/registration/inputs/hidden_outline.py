"""How much of a part's outline something nearer hides: what is seen of such a part may not be all of it."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter

from kit1000.values import LabelledDepth

WIDTH = 2  # [px] of the ring around the part


def hidden_outline(image: LabelledDepth, label: int) -> float:
    """The share, 0 to 1, of a ring around a body that shows another body nearer than the one inside.

    Args:
        image: with the labels of kits and parts.
        label: of the body, from 1 on. 0.0 where no pixel has it.
    """
    body, depth = image.labels == label, image.view.depth
    ring = maximum_filter(body, 2 * WIDTH + 1) & ~body
    inside = maximum_filter(np.where(body, depth, 0.0), 2 * WIDTH + 1)  # the farthest pixel beside; 0 has no return
    nearer = ring & (image.labels > 0) & (depth > 0) & (depth < inside)
    return float(np.count_nonzero(nearer) / max(np.count_nonzero(ring), 1))
