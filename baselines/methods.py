"""How a method is made, from its name in the catalog or from `module:Object` of your own."""

from __future__ import annotations

import hashlib
import inspect
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from baselines.catalog import WEIGHTS, Method, all_methods, weight_paths
from baselines.segmentation.queries import MASKS_WEIGHTS, OnPredictedMasks
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, did_you_mean
from kit1000.predictor import Predictor, resolved
from kit1000.tracks import ALL_TRACKS

SEGMENTATION = [Path(__file__).parent / name for name in ("restoration", "segmentation")]
MASKS_TRAINING = "split train of kit1000, for the masks of noisy images"
ATTRIBUTES = (
    *("tracks", "uses_true_geometry", "learned", "predicts"),
    *("training_data", "camera_set", "label", "paper_row"),
)
"""What is read from a method of your own."""
PREDICTED_MASKS = "+predicted-masks"  # after the name of a method: it is run without the masks of the dataset


def method_of(name: str) -> Method:
    """A method of the catalog, or one of your own by `module:Object`, described by its ATTRIBUTES.

    With PREDICTED_MASKS after its name it reads predicted masks.
    """
    methods = all_methods()
    if name.endswith(PREDICTED_MASKS):
        return _on_predicted_masks(method_of(name.removesuffix(PREDICTED_MASKS)))
    if name in methods:
        return methods[name]
    if ":" not in name:
        known = ", ".join(methods)
        raise InputError(
            f"no method {name!r}; {did_you_mean(name, methods)}there are {known}, or module:Object of your own"
        )
    target = resolved(name)
    values = {attribute: getattr(target, attribute, None) for attribute in ATTRIBUTES}
    stated = {key: value for key, value in values.items() if value is not None and not isinstance(value, property)}
    return Method(name, (inspect.getdoc(target) or name).splitlines()[0], **stated)


def make_predictor(method: Method, dataset: Dataset, seed: int) -> Predictor:
    """The predictor of a method, ready to be called. seed: of all its draws."""
    predictor: Any = resolved(method.make)
    if isinstance(predictor, type):
        takes_seed = "seed" in inspect.signature(predictor).parameters
        weights = weight_paths(method.weights)
        predictor = predictor(dataset, **method.options, **weights, **({"seed": seed} if takes_seed else {}))
    given = method.masks == "given"
    return predictor if given else OnPredictedMasks(predictor, dataset.summary["config"]["scale"])


def _on_predicted_masks(method: Method) -> Method:
    """A method that reads predicted masks; raises InputError where masks are no input of it."""
    if method.uses_true_geometry or method.control:
        raise InputError(f"--masks predicted: {method.make} reads the truth or is a control; use --masks given")
    label = f"{method.label}, predicted masks" if method.label else ""
    description = f"{method.description}; masks from depth alone, which a network restores where it is noisy"
    seen = "; ".join(dict.fromkeys(filter(None, (method.training_data, MASKS_TRAINING))))
    return replace(method, masks="predicted", label=label, description=description, learned=True, training_data=seen)


def source_hash(method: Method) -> str:
    """SHA-256 in hex of a method's code and weights: all files of its package, or its module where it has none."""
    spec = find_spec(method.make.partition(":")[0])
    assert spec is not None, "methods are resolved before they are hashed"
    assert spec.origin is not None
    package = spec.name if spec.submodule_search_locations else spec.parent
    origin = Path(spec.origin)
    files = [origin] if package in ("", __package__) else sorted(origin.parent.rglob("*.py"))
    predicted = method.masks == "predicted"
    files += [file for folder in SEGMENTATION for file in sorted(folder.glob("*.py")) if predicted]
    stems = [*method.weights.values(), *(MASKS_WEIGHTS if predicted else ())]
    files += [WEIGHTS / f"{stem}.safetensors" for stem in stems]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def listed(name: str, method: Method) -> str:
    """A method in one line of a list."""
    without = [track for track in ALL_TRACKS if track not in method.tracks]
    notes = [word for word in ("control", "learned") if getattr(method, word)]
    notes += ["uses true geometry"] if method.uses_true_geometry else []
    notes += [f"not {', '.join(without)}"] if without else []
    return f"{name:26s} {method.description}" + (f" ({'; '.join(notes)})" if notes else "")
