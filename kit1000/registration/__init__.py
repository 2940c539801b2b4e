"""Registration without learning: a part and a kit as height images along the insertion axis, searched, then refined.

Read it in the order of the method: `inputs` (volumes of the part and the kits, from the image or the truth),
`geometry` (cavities, faces, envelopes), `search` (all yaws and positions, and the candidates that they leave),
`refinement` (of a candidate to a fit), `choice` (among fits, and how confident it is). `method` is the predictor,
`proposed_fits` hands out all its fits.
"""

from kit1000.prediction.catalog import Method
from kit1000.weights import WEIGHTS

METHODS = {
    "registration": Method(
        "kit1000.registration.proposed_fits:ProposingRegistration",
        "height images of part and kits are searched and refined by what the depth image makes certain",
        label="Registration, from depth",
        options={"source": "depth"},
    ),
    "registration-completed": Method(
        "kit1000.registration.proposed_fits:CompletingRegistration",
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
    "registration-three": Method(
        "kit1000.registration.proposed_fits:ProposingRegistration",
        "registration from four depth images: the query's and those of three cameras around the table",
        label="Registration, four cameras",
        options={"source": "depth", "cameras": "three"},
        tracks=("snap", "snap-tilt", "place", "place-paper"),
        camera_set="three",
    ),
    "registration-columns": Method(
        "kit1000.registration.proposed_fits:ProposingRegistration",
        "registration from the depth image, the part taken to be solid below what is observed",
        label="Registration, filled columns",
        options={"source": "columns"},
    ),
    "registration-any-clearance": Method(
        "kit1000.registration.proposed_fits:ProposingRegistration",
        "registration from the depth image without the clearance: 1, 2.5, 5 and 10 mm are tried",
        label="Registration, clearance unknown",
        options={"source": "depth", "clearances": (1e-3, 2.5e-3, 5e-3, 10e-3)},
    ),
    "registration-gtvol": Method(
        "kit1000.registration.proposed_fits:ProposingRegistration",
        "registration from the true shapes of part and kits",
        label="Registration, true geometry",
        options={"source": "truth"},
        uses_true_geometry=True,
    ),
}
