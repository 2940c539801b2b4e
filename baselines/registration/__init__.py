"""Registration without learning: a part and a kit as height images along the insertion axis, searched, then refined.

Read it in the order of the method: `sources` (volumes), `baselines.completion.planes` (plates), `cavity` (the cavity of
a plate), `faces` (those the part can stand on), `relief` (its lower envelope, dilated by the clearance), `search` (all
yaws and positions) and `hypotheses`, which joins them. Then either `columns`, which believes a filled part (`sweep`,
`descent`, `refine`), or `certain`, which asks only what the image makes certain (`contradictions`, `intervals`).
Without a guess `assignment` asks the other parts of the scene where two plates fit about as well; they share what was
found in the image (`shared_image`). How likely the best fit is seated says `confidence`, by the residuals left, the
next best fit and how much of the part is hidden (`hidden_outline`). `method` is the predictor.
"""

from baselines.catalog import Method

METHODS = {
    "registration": Method(
        "baselines.registration.method:Registration",
        "height images of part and kits are searched and refined by what the depth image makes certain",
        label="Registration, from depth",
        options={"source": "depth"},
    ),
    "registration-completed": Method(
        "baselines.registration.method:Registration",
        "registration from the depth image, the part completed by a network, noisy images restored by another one",
        label="Registration, completed part",
        options={"source": "depth"},
        learned=True,
        training_data="40,000 fresh parts of the families of split train, from both sensors; split train of kit1000",
        weights={
            "completion": "completion",
            "noisy_completion": "completion-d415",
            "restoration": "restoration",
        },
    ),
    "registration-three": Method(
        "baselines.registration.method:Registration",
        "registration from four depth images: the query's and those of three cameras around the table",
        label="Registration, four cameras",
        options={"source": "depth", "cameras": "three"},
        tracks=("snap", "snap-tilt", "place", "place-paper"),
        camera_set="three",
    ),
    "registration-columns": Method(
        "baselines.registration.method:Registration",
        "registration from the depth image, the part taken to be solid below what is observed",
        label="Registration, filled columns",
        options={"source": "columns"},
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
