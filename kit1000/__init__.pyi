"""The public names of kit1000, which its `__init__.py` loads on first use."""

from .camera import Camera as Camera
from .camera import look_at as look_at
from .dataset.reader import Dataset as Dataset
from .dataset.reader import RecordedScene as RecordedScene
from .dataset.reader import Split as Split
from .errors import InputError as InputError
from .errors import Kit1000Error as Kit1000Error
from .errors import MeshRefused as MeshRefused
from .errors import Redraw as Redraw
from .errors import ShapeError as ShapeError
from .export.own_part import KitOptions as KitOptions
from .export.own_part import make_kit_from_file as make_kit_from_file
from .kits.kit import make_kit as make_kit
from .mesh import Mesh as Mesh
from .parts.family import make_part as make_part
from .pose import Pose as Pose
from .predictor import PredictedMotion as PredictedMotion
from .predictor import Predictor as Predictor
from .submission.folder import Submission as Submission
from .submission.folder import read_submission as read_submission
from .submission.folder import write_submission as write_submission
from .submission.manifest import Manifest as Manifest
from .submission.predictions import Predictions as Predictions
from .symmetry import Symmetry as Symmetry
from .values import Assembly as Assembly
from .values import Body as Body
from .values import FreeAxis as FreeAxis
from .values import Kit as Kit
from .values import LabelledDepth as LabelledDepth
from .values import Mount as Mount
from .values import Part as Part
from .values import Prediction as Prediction
from .values import Query as Query
from .values import Scene as Scene
from .values import Slot as Slot
from .values import TrueGeometry as TrueGeometry
from .values import Truth as Truth
from .values import View as View

__version__: str
