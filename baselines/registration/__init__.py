"""Registration without learning: a part and a kit as height images along the insertion axis, searched, then refined.

Read it in the order of the method: `sources` (volumes), `baselines.completion.planes` (plates), `cavity` (the cavity of
a plate), `faces` (those the part can stand on), `relief` (its lower envelope, dilated by the clearance), `search` (all
yaws and positions), `refine` (the last millimetre) and `method`, which joins them.
"""

from baselines.catalog import Method

METHODS = {
    "registration": Method(
        "baselines.registration.method:Registration",
        "search over yaws and positions, then refinement, of height images of part and kits, from the depth image",
        label="Registration, from depth",
        options={"source": "depth"},
    ),
    "registration-any-clearance": Method(
        "baselines.registration.method:Registration",
        "registration from the depth image without the clearance: 1, 2.5, 5 and 10 mm are tried",
        label="Registration, clearance unknown",
        options={"source": "depth", "clearances": (1e-3, 2.5e-3, 5e-3, 10e-3)},
    ),
    "registration-gtvol": Method(
        "baselines.registration.method:Registration",
        "registration from the true shapes of part and kits",
        label="Registration, true geometry",
        options={"source": "truth"},
        uses_true_geometry=True,
    ),
}
