"""The command that makes a scene of the user's own depth image."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from kit1000.cli.options import OptionalFloat, OptionalName, OptionalPath, optional
from kit1000.dataset.own_scenes import is_labelled, is_own
from kit1000.errors import InputError
from kit1000.files import read_json

if TYPE_CHECKING:
    from kit1000.capture.options import ImportOptions

Stream = Literal["raw", "aligned"]
Masks = Literal["depth", "networks"]


def need_truth(data: Path, command: str) -> None:
    """Raise InputError for a folder of own scenes without labels: it has no ground truth, parts or kits."""
    path = data / "dataset.json"
    summary = read_json(path) if path.is_file() else {}
    if isinstance(summary, dict) and is_own(summary) and not is_labelled(summary):
        raise InputError(f"{data}: own scenes, without ground truth, which {command} needs; kit1000 label adds it")


@dataclass(frozen=True, kw_only=True)
class OwnImages:
    """Options that say what own depth images are."""

    intrinsics: Annotated[tuple[str, ...], arg(metavar="FILE | FX FY CX CY")] = ()
    """JSON of BOP, Open3D, RealSense, ROS or gqcnn, .txt of 3 x 3, or four numbers [px]; recordings bring their own."""
    depth_scale: OptionalFloat = None
    """Metres that 1 in an image stands for; as the files say, else 0.001 for integers and 1 for floats."""
    topic: OptionalName = None
    """Topic of the depth images in a recording; the only one when absent."""
    frames: int = 1
    """Number of successive frames of which an image is the median."""
    first: int = 0
    """Index of the first frame of a recording."""
    device: str = ""
    """Name of the camera, such as D435, or PhoXi for a structured-light scanner; as the files say when absent."""
    baseline_mm: OptionalFloat = None
    """Distance between the camera's imagers; known for RealSense cameras."""
    stream: Annotated[Stream | None, optional(Stream)] = None
    """raw: the depth camera's own image; aligned: resampled to another camera; as the files say, else raw of a
    scanner and aligned of other cameras."""
    kit: int = 1
    """Number of the body that is the kit, the largest first."""
    world_from_camera: Annotated[tuple[Path, ...], arg(metavar="FILE [FILE ...]")] = ()
    """JSON file of a hand-eye pose in a frame with the table at z = 0, which is kept; one for all images, or one for
    each; by the bodies when absent."""
    empty_table: OptionalPath = None
    """Depth image of the same camera and table without bodies."""
    clearance_mm: OptionalFloat = None
    """Gap between a part and the walls of its cavity."""
    masks: Annotated[Masks | None, optional(Masks)] = None
    """depth: bodies as depth alone shows them; networks: cut back by the networks, of a scanner by rules; when absent
    networks where torch is there."""
    check: Annotated[tuple[float, ...], arg(metavar="MM MM MM")] = ()
    """Sides of a box in view: images in which no body has them are refused."""

    def own_options(self) -> list[str]:
        """The options of own images that are given."""
        given = [field.name for field in fields(OwnImages) if getattr(self, field.name) != field.default]
        return [f"--{name.replace('_', '-')}" for name in given]

    def asked(self, sources: tuple[Path, ...], out: Path, licence: str = "", one_scene: bool = False) -> ImportOptions:
        """The import that these options describe."""
        from kit1000.capture.mask_networks import networks_available
        from kit1000.capture.options import LICENCE, ImportOptions

        values = {field.name: getattr(self, field.name) for field in fields(OwnImages)}
        masks = values.pop("masks")
        networks = masks == "networks" or (masks is None and networks_available())
        rest = {"networks": networks, "licence": licence or LICENCE, "one_scene": one_scene}
        return ImportOptions(sources=sources, out=out, **values, **rest)


@dataclass(frozen=True)
class ImportImages(OwnImages):
    """Make a scene folder of your own depth images: finds table, kit and parts, and prints their sizes."""

    sources: Annotated[Positional[tuple[Path, ...]], arg(metavar="SOURCE [SOURCE ...]")]
    """16-bit PNG or TIFF, .npy, .npz, or MCAP of ROS 2, Foxglove or ours. Several images become several scenes."""
    out: OptionalPath = None
    """Folder to write to; the name of the first image with -scene when absent."""
    one_scene: bool = False
    """The images show the same bodies from several places, each with its pose: methods of registration use all."""
    licence: str = ""
    """Licence of the images, for the recordings."""

    def run(self) -> int:
        """Import, print the report and the folder."""
        from kit1000.capture.importing import default_folder, import_scenes

        out = self.out or default_folder(self.sources)
        for line in import_scenes(self.asked(self.sources, out, self.licence, self.one_scene)):
            print(line)
        print(f"{out}: open it with kit1000 edit {out}")
        return 0
