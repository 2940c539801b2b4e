"""How a method is made: from its name in the catalog or from your own `module:Object` or `file.py:Object`, with the
published weights or those of your own training runs.
"""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, InternalError, Kit1000Error, did_you_mean, failure_text
from kit1000.files import read_json, sha256
from kit1000.prediction.catalog import TABLES, Method, all_methods
from kit1000.prediction.imported_sources import hash_of, imported_modules
from kit1000.predictor import Predictor, module_and_object, resolved
from kit1000.queries.tracks import ALL_TRACKS
from kit1000.weights import WEIGHTS

LIBRARY = Path(__file__).parents[1]
"""Folder of the package `kit1000`."""
MASKS_TRAINING = "split train of kit1000, for the masks of noisy images"
ATTRIBUTES = (
    *("tracks", "uses_true_geometry", "reads", "learned", "predicts"),
    *("training_data", "camera_set", "label", "paper_row"),
)
"""Attributes that describe your own method."""
PREDICTED_MASKS = "+predicted-masks"  # after the name of a method: it runs without the masks of the dataset
BEST = "best"  # stem of the best weights in the folder of a run
MAX_LABEL = 80  # characters of a label in a manifest
DIGITS = 12  # of a hash in a text


def method_of(name: str, tables: Sequence[str] = TABLES) -> Method:
    """A method of the tables, or your own by `module:Object` or `file.py:Object`, described by its ATTRIBUTES.

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
    from kit1000.perception.segmentation.predicted_masks import OnPredictedMasks

    return OnPredictedMasks(predictor, dataset.summary["config"]["scale"], dataset.summary)


def _on_predicted_masks(method: Method) -> Method:
    """A method that reads predicted masks; raises InputError if it reads no masks."""
    if method.uses_true_geometry or method.control:
        raise InputError(f"--masks predicted: {method.make} reads the truth or is a control; use --masks given")
    label = f"{method.label}, found masks" if method.label else ""
    description = f"{method.description}; masks from depth alone, which a network restores where it is noisy"
    seen = "; ".join(dict.fromkeys(filter(None, (method.training_data, MASKS_TRAINING))))
    found = replace(method, masks="predicted", label=label, description=description, learned=True, training_data=seen)
    return replace(found, paper_row="")  # that row is of the masks of the dataset


def with_weights(method: Method, runs: Sequence[str | Path]) -> Method:
    """A method with the weights of runs instead of its published ones; its training data names them.

    Args:
        method: of the catalog.
        runs: folders that `python -m baselines train` wrote, or files NAME.safetensors beside their NAME.json.

    Raises:
        InputError: a run without weights, or with those of a network that the method does not use.
    """
    if not runs:
        return method
    weights, texts = dict(method.weights), []
    for run in map(Path, runs):
        stem = _stem(run)
        about = _about(stem, run)
        name = about.get("name")
        places = [argument for argument, path in method.weights.items() if path.name == name]
        if not places:
            used = ", ".join(sorted(path.name for path in method.weights.values())) or "no weights"
            raise InputError(f"--weights {run}: weights of {name}, which the method does not use; it uses {used}")
        weights |= dict.fromkeys(places, stem)
        digest = sha256(stem.with_name(f"{stem.name}.safetensors")) or ""
        data = f"dataset {about.get('dataset_id', 'unknown')}, preset {about.get('preset', 'unknown')}"
        texts.append(f"{name}: split train of {data} (own weights {digest[:DIGITS]})")
    published = [path for argument, path in method.weights.items() if weights[argument] == path]
    others = [f"published weights of the other networks: {method.training_data}"] if published else []
    label = f"{method.label}, own weights"[:MAX_LABEL] if method.label else ""
    return replace(method, weights=weights, label=label, training_data="; ".join([*texts, *others]))


def _stem(run: Path) -> Path:
    """The path of a run's weights without suffix."""
    stem = run.with_suffix("") if run.suffix == ".safetensors" else run / BEST
    for suffix in (".json", ".safetensors"):
        path = stem.with_name(stem.name + suffix)
        if not path.is_file():
            raise InputError(f"--weights {run}: no file {path}; expected the folder of a run with its best weights")
    return stem


def _about(stem: Path, run: Path) -> dict[str, Any]:
    """The description of a run's weights in the file beside them."""
    info = read_json(stem.with_name(f"{stem.name}.json"))
    about = info.get("about") if isinstance(info, dict) else None
    if not isinstance(about, dict):
        raise InputError(f"--weights {run}: {stem.name}.json describes no weights of a training run")
    return about


def source_hash(method: Method) -> str:
    """SHA-256 in hex of what a method's predictions depend on: its module, all that it imports of KIT1000, its weights.

    A JSON file beside a module, with the module's name, counts too: it holds numbers of the module. So does, for your
    own module, all that it imports from the same package or folder. The hash tells rows of one code from rows of
    another, also in a checkout with changes and for code that is in no checkout: a commit could not.
    """
    entries = [module_and_object(method.make)[0]]
    folder = _source_folder(entries[0])
    beside = {path.stem: path for path in folder.glob("*.py")}
    beside |= {path.parent.name: path.parent for path in folder.glob("*/__init__.py")}
    roots = beside | {"kit1000": LIBRARY}
    stems = {stem.name: stem for stem in method.weights.values()}
    if len(stems) < len(method.weights):  # the weights of all runs have one name
        stems = {f"{argument}:{stem.name}": stem for argument, stem in method.weights.items()}
    if method.masks == "predicted":
        from kit1000.perception.segmentation.predicted_masks import MASKS_WEIGHTS, OnPredictedMasks

        entries.append(OnPredictedMasks.__module__)
        stems |= {name: WEIGHTS / name for name in MASKS_WEIGHTS}
    files = imported_modules(entries, roots)
    files |= {f"{name}.json": data for name, path in files.items() if (data := path.with_suffix(".json")).is_file()}
    files |= {name: stem.with_name(f"{stem.name}.safetensors") for name, stem in stems.items()}
    return hash_of(files)


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
