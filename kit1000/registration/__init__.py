"""Registration without learning: height maps of part and kits along the insertion axis are searched, then refined.

Read it in the order of the method: `predictor` (a query in, a motion out), `prepared_image` (the image, calibrated and
restored), `part_volume` and `kit_volume` (what it shows of part and kits), `method` (registration from search to fit),
`search`, `contradictions`, `refine`, `image_refine`, `rank`, `several_images`; `geometry` has what they compare.
"""

from kit1000.prediction.catalog import Method
from kit1000.weights import WEIGHTS

METHODS = {
    "registration": Method(
        "kit1000.registration.predictor:Registration",
        "height images of part and kits are searched and refined by what the depth image makes certain",
        label="Registration, from depth",
        options={"source": "depth"},
    ),
    "registration-completed": Method(
        "kit1000.registration.predictor:Registration",
        "registration from the depth image, the part completed by a network, noisy images restored by others",
        label="Registration, completed part",
        options={"source": "depth"},
        learned=True,
        training_data="40,000 sampled parts; 34,500 views and 2218 fits of split train by ideal depth, d415 and "
        "photoneo, data version 2.0.0",
        weights={
            "completion": WEIGHTS / "completion",
            "noisy_completion": WEIGHTS / "completion-d415",
            "restoration": WEIGHTS / "restoration",
            "hole_filling": WEIGHTS / "hole-filling",
            "placement": WEIGHTS / "placement",
        },
    ),
    "registration-columns": Method(
        "kit1000.registration.predictor:Registration",
        "registration from the depth image, the part taken to be solid below what is observed",
        label="Registration, filled columns",
        options={"source": "columns"},
    ),
    "registration-any-clearance": Method(
        "kit1000.registration.predictor:Registration",
        "registration from the depth image without the clearance: 1, 2.5, 5 and 10 mm are tried",
        label="Registration, clearance unknown",
        options={"source": "depth", "clearances": (1e-3, 2.5e-3, 5e-3, 10e-3)},
    ),
    "registration-gtvol": Method(
        "kit1000.registration.predictor:Registration",
        "registration from the true shapes of part and kits",
        label="Registration, true geometry",
        options={"source": "truth"},
        uses_true_geometry=True,
    ),
}
