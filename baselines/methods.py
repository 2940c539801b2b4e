"""All reference methods by name, and how a method is made from its name or from `module:Object`."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, near
from kit1000.predictor import Predictor
from kit1000.tracks import CURVES, TRACKS

EVERY = (*TRACKS, CURVES)
WEIGHTS = Path(__file__).parent / "weights"
GUESSED = ("snap", "snap-tilt", "snap-d415", CURVES)
"""Tracks whose queries come with a guess."""


@dataclass(frozen=True)
class Method:
    """What is known of a method before it is made."""

    make: str
    """`module:Object`: a predictor as it is, or a class, called with dataset, options, and a seed if it takes one."""
    description: str
    """One line."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Further arguments of the class."""
    tracks: tuple[str, ...] = EVERY
    """Those it answers; a method that turns a guess into an answer cannot do without one."""
    uses_true_geometry: bool = False
    """Whether it is handed the truth."""
    learned: bool = False
    control: bool = False
    """Whether its row says something about the benchmark and not about a method."""
    predicts: Literal["pose", "rotation"] = "pose"
    training_data: str = ""
    """What it learned from."""
    weights: Mapping[str, str] = field(default_factory=dict)
    """Further arguments of the class: names of files in WEIGHTS, handed over as paths without an ending."""


SNAPNET_GTVOL = Method(
    "baselines.snapnet:SnapNet",
    "SnapNet of the paper in its small size, from true volumes",
    options={"kind": "truth"},
    tracks=GUESSED,
    uses_true_geometry=True,
    learned=True,
    training_data="split train of kit1000",
    weights={"position": "snapnet-gtvol-position", "rotation": "snapnet-gtvol-rotation"},
)
SNAPNET_PARTIALVOL = replace(
    SNAPNET_GTVOL,
    description="SnapNet in its small size, from one depth image; what that hides is filled in columns",
    options={"kind": "partial"},
    uses_true_geometry=False,
    weights={"position": "snapnet-partialvol-position", "rotation": "snapnet-partialvol-rotation"},
)


def _mean_of_turns(method: Method) -> Method:
    return replace(
        method,
        description=f"{method.description}; the mean of the turns around the best one",
        options={**method.options, "peak": "mean"},
    )


SNAPNET_GTVOL_FINE = _mean_of_turns(SNAPNET_GTVOL)

METHODS = {
    "truth": Method(
        "baselines.controls:TrueGoal",
        "the goal itself: no error at all",
        uses_true_geometry=True,
        control=True,
    ),
    "truth-symmetric": Method(
        "baselines.controls:SymmetricGoal",
        "any of the goals, turned about the free axis by any angle: no error either",
        uses_true_geometry=True,
        control=True,
    ),
    "truth-noise": Method(
        "baselines.controls:NoisyGoal",
        "the goal missed by exactly 2 mm and 2 degrees",
        uses_true_geometry=True,
        control=True,
    ),
    "guess": Method(
        "baselines.controls:guess",
        "the guess, left as it is",
        tracks=GUESSED,
        control=True,
    ),
    "chance": Method(
        "baselines.controls:Chance",
        "any motion: near the guess or, without one, to a point on the kits at any yaw",
        control=True,
    ),
    "icp": Method(
        "baselines.icp:Icp",
        "from the guess, point-to-plane ICP of the part's shell onto the kits, by Open3D",
        tracks=GUESSED,
    ),
    "registration": Method(
        "baselines.registration:Registration",
        "search of turns and places, then refinement, of one height map in another, from the depth image",
        options={"source": "depth"},
    ),
    "registration-any-clearance": Method(
        "baselines.registration:Registration",
        "the same, not told the clearance: 1, 2.5, 5 and 10 mm are tried",
        options={"source": "depth", "clearances": (1e-3, 2.5e-3, 5e-3, 10e-3)},
    ),
    "registration-gtvol": Method(
        "baselines.registration:Registration",
        "registration from the true shapes of part and kits",
        options={"source": "truth"},
        uses_true_geometry=True,
    ),
    "snapnet-gtvol": SNAPNET_GTVOL,
    "snapnet-gtvol-fine": SNAPNET_GTVOL_FINE,
    "snapnet-gtvol-twice": replace(
        SNAPNET_GTVOL_FINE,
        description=f"{SNAPNET_GTVOL_FINE.description}; it looks again from its own answer",
        options={**SNAPNET_GTVOL_FINE.options, "passes": 2},
    ),
    "snapnet-partialvol": SNAPNET_PARTIALVOL,
    "snapnet-partialvol-fine": _mean_of_turns(SNAPNET_PARTIALVOL),
}


def method_of(name: str) -> Method:
    """A method of METHODS, or one of your own by `module:Object`, which may say what it is in attributes.

    Of those `uses_true_geometry`, `learned`, `tracks`, `predicts` and `training_data` are read.
    """
    if name in METHODS:
        return METHODS[name]
    if ":" not in name:
        known = ", ".join(METHODS)
        raise InputError(f"no method {name!r}; {near(name, METHODS)}there are {known}, or module:Object of your own")
    told = ("tracks", "uses_true_geometry", "learned", "predicts", "training_data")
    target = resolved(name)
    values = {key: getattr(target, key, None) for key in told}
    said = {key: value for key, value in values.items() if value is not None and not isinstance(value, property)}
    return Method(name, (inspect.getdoc(target) or name).splitlines()[0], **said)


def made(method: Method, dataset: Dataset, seed: int) -> Predictor:
    """The predictor of a method, ready to be called. seed: of all its draws."""
    target: Any = resolved(method.make)
    if not isinstance(target, type):
        return target
    takes_seed = "seed" in inspect.signature(target).parameters
    weights = {name: WEIGHTS / stem for name, stem in method.weights.items()}
    return target(dataset, **method.options, **weights, **({"seed": seed} if takes_seed else {}))


def resolved(target: str) -> Any:
    """What `module:Object` names; raises InputError when there is no such thing."""
    module, _, name = target.partition(":")
    try:
        found = getattr(import_module(module), name, None)
    except ImportError as error:
        raise InputError(f"{target}: {' '.join(str(error).split())}") from error
    if not callable(found):
        raise InputError(f"{target}: {module} has no {name or 'object'} that could be called")
    return found


def source_hash(method: Method) -> str:
    """SHA-256 in hex of what the method is made of: its module, or all files of its package, and its weights."""
    spec = find_spec(method.make.partition(":")[0])
    assert spec is not None, "methods are resolved before they are hashed"
    assert spec.origin is not None
    origin = Path(spec.origin)
    files = sorted(origin.parent.rglob("*.py")) if spec.submodule_search_locations else [origin]
    files += [WEIGHTS / f"{stem}.safetensors" for stem in method.weights.values()]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def described(name: str, method: Method) -> str:
    """A method in one line of a list."""
    without = [track for track in EVERY if track not in method.tracks]
    notes = [word for word in ("control", "learned") if getattr(method, word)]
    notes += ["reads the truth"] if method.uses_true_geometry else []
    notes += [f"not {', '.join(without)}"] if without else []
    told = f" ({'; '.join(notes)})" if notes else ""
    return f"{name:20s} {method.description}{told}"
