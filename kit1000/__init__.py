"""KIT1000: parts, kits that fit them, and angled assemblies of kits, for research on 6DoF kit assembly.

The public names are defined here and load on first use, so `import kit1000` takes almost no time.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from kit1000.version import __version__ as __version__

if TYPE_CHECKING:
    from kit1000.camera import Camera, look_at
    from kit1000.dataset.reader import Dataset, RecordedScene, Split
    from kit1000.errors import InputError, Kit1000Error, MeshRefused, Redraw, ShapeError
    from kit1000.export.own_part import make_kit_from_file
    from kit1000.kits.kit import make_kit
    from kit1000.mesh import Mesh
    from kit1000.parts.family import make_part
    from kit1000.pose import Pose
    from kit1000.predictor import PredictedMotion, Predictor
    from kit1000.submission.folder import Submission, read_submission, write_submission
    from kit1000.submission.manifest import Manifest
    from kit1000.submission.predictions import Predictions
    from kit1000.symmetry import Symmetry
    from kit1000.values import (
        Assembly,
        Body,
        FreeAxis,
        Kit,
        LabelledDepth,
        Mount,
        Part,
        Prediction,
        Query,
        Scene,
        Slot,
        TrueGeometry,
        Truth,
        View,
    )

__all__ = [
    "Assembly",
    "Body",
    "Camera",
    "Dataset",
    "FreeAxis",
    "InputError",
    "Kit",
    "Kit1000Error",
    "LabelledDepth",
    "Manifest",
    "Mesh",
    "MeshRefused",
    "Mount",
    "Part",
    "Pose",
    "PredictedMotion",
    "Prediction",
    "Predictions",
    "Predictor",
    "Query",
    "RecordedScene",
    "Redraw",
    "Scene",
    "ShapeError",
    "Slot",
    "Split",
    "Submission",
    "Symmetry",
    "TrueGeometry",
    "Truth",
    "View",
    "look_at",
    "make_kit",
    "make_kit_from_file",
    "make_part",
    "read_submission",
    "write_submission",
]

_MODULES = {
    "Camera": "camera",
    "look_at": "camera",
    "Dataset": "dataset.reader",
    "RecordedScene": "dataset.reader",
    "Split": "dataset.reader",
    "InputError": "errors",
    "Kit1000Error": "errors",
    "MeshRefused": "errors",
    "Redraw": "errors",
    "ShapeError": "errors",
    "make_kit_from_file": "export.own_part",
    "make_kit": "kits.kit",
    "Mesh": "mesh",
    "make_part": "parts.family",
    "Pose": "pose",
    "PredictedMotion": "predictor",
    "Predictor": "predictor",
    "Submission": "submission.folder",
    "read_submission": "submission.folder",
    "write_submission": "submission.folder",
    "Manifest": "submission.manifest",
    "Predictions": "submission.predictions",
    "Symmetry": "symmetry",
}  # of names that are not in values


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'kit1000' has no attribute {name!r}; it has {', '.join(__all__)}")
    return getattr(import_module(f"kit1000.{_MODULES.get(name, 'values')}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
