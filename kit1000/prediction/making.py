"""How a method is made, from its name in the catalog or from `module:Object` or `file.py:Object` of your own."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, InternalError, Kit1000Error, did_you_mean, failure_text
from kit1000.perception.segmentation import predicted_masks
from kit1000.perception.segmentation.predicted_masks import MASKS_WEIGHTS, OnPredictedMasks
from kit1000.prediction.catalog import TABLES, Method, all_methods
from kit1000.prediction.imported_sources import imported_modules
from kit1000.predictor import Predictor, module_and_object, resolved
from kit1000.queries.tracks import ALL_TRACKS
from kit1000.weights import WEIGHTS

LIBRARY = Path(__file__).parents[1]
"""Folder of the package `kit1000`."""
MASKS_TRAINING = "split train of kit1000, for the masks of noisy images"
ATTRIBUTES = (
    *("tracks", "uses_true_geometry", "learned", "predicts"),
    *("training_data", "camera_set", "label", "paper_row"),
)
"""What is read from a method of your own."""
PREDICTED_MASKS = "+predicted-masks"  # after the name of a method: it is run without the masks of the dataset


def method_of(name: str, tables: Sequence[str] = TABLES) -> Method:
    """A method of the tables, or one of your own by `module:Object` or `file.py:Object`, described by its ATTRIBUTES.

    With PREDICTED_MASKS after its name it reads predicted masks.
    """
    methods = all_methods(tables)
    if name.endswith(PREDICTED_MASKS):
        return _on_predicted_masks(method_of(name.removesuffix(PREDICTED_MASKS), tables))
    if name in methods:
        return methods[name]
    if name.endswith(".py"):
        raise InputError(f"{name}: expected the file and its function or class, such as {name}:predict")
    if ":" not in name:
        known = ", ".join(methods)
        hint = f"{did_you_mean(name, methods)}there are {known}, or module:Object or FILE.py:Object of your own"
        raise InputError(f"no method {name!r}; {hint}")
    target = resolved(name)
    values = {attribute: getattr(target, attribute, None) for attribute in ATTRIBUTES}
    stated = {key: value for key, value in values.items() if value is not None and not isinstance(value, property)}
    return Method(name, (inspect.getdoc(target) or name).splitlines()[0], **stated)


def make_predictor(method: Method, dataset: Dataset, seed: int) -> Predictor:
    """The predictor of a method, ready to be called. seed: of all its draws."""
    predictor: Any = resolved(method.make)
    if isinstance(predictor, type):
        takes_seed = "seed" in inspect.signature(predictor).parameters
        seeded = {"seed": seed} if takes_seed else {}
        try:
            predictor = predictor(dataset, **method.options, **method.weights, **seeded)
        except Kit1000Error:
            raise
        except (Exception, SystemExit) as error:
            raise InternalError(f"{method.make}: {failure_text(error)}") from error
    if method.masks == "given":
        return predictor
    return OnPredictedMasks(predictor, dataset.summary["config"]["scale"], dataset.summary)


def _on_predicted_masks(method: Method) -> Method:
    """A method that reads predicted masks; raises InputError where masks are no input of it."""
    if method.uses_true_geometry or method.control:
        raise InputError(f"--masks predicted: {method.make} reads the truth or is a control; use --masks given")
    label = f"{method.label}, predicted masks" if method.label else ""
    description = f"{method.description}; masks from depth alone, which a network restores where it is noisy"
    seen = "; ".join(dict.fromkeys(filter(None, (method.training_data, MASKS_TRAINING))))
    return replace(method, masks="predicted", label=label, description=description, learned=True, training_data=seen)


def source_hash(method: Method) -> str:
    """SHA-256 in hex of what a method's predictions depend on: its module, all that it imports of ours, its weights.

    Of a module of your own, what it imports from the same package or folder counts too.
    """
    entries = [module_and_object(method.make)[0], *([predicted_masks.__name__] if method.masks == "predicted" else [])]
    folder = _source_folder(entries[0])
    beside = {path.stem: path for path in folder.glob("*.py")}
    beside |= {path.parent.name: path.parent for path in folder.glob("*/__init__.py")}
    roots = beside | {"kit1000": LIBRARY}
    stems = {stem.name: stem for stem in method.weights.values()}
    if len(stems) < len(method.weights):  # those of runs all have one name
        stems = {f"{argument}:{stem.name}": stem for argument, stem in method.weights.items()}
    stems |= {name: WEIGHTS / name for name in MASKS_WEIGHTS if method.masks == "predicted"}
    files = imported_modules(entries, roots)
    files |= {name: stem.with_name(f"{stem.name}.safetensors") for name, stem in stems.items()}
    digest = hashlib.sha256()
    for name in sorted(files):
        digest.update(name.encode() + b"\0" + hashlib.sha256(files[name].read_bytes()).digest())
    return digest.hexdigest()


def _source_folder(module: str) -> Path:
    """The folder that holds the top-level package or module of a module."""
    top = module.partition(".")[0]
    spec = find_spec(top)
    assert spec is not None, "methods are resolved before they are hashed"
    if spec.submodule_search_locations:
        return Path(next(iter(spec.submodule_search_locations))).parent
    assert spec.origin is not None
    return Path(spec.origin).parent


def listed(name: str, method: Method) -> str:
    """A method in one line of a list."""
    without = [track for track in ALL_TRACKS if track not in method.tracks]
    notes = [word for word in ("control", "learned") if getattr(method, word)]
    notes += ["uses true geometry"] if method.uses_true_geometry else []
    notes += [f"not {', '.join(without)}"] if without else []
    return f"{name:26s} {method.description}" + (f" ({'; '.join(notes)})" if notes else "")
