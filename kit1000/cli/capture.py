"""The command that makes scenes from the user's own depth images."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

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


def default_folder(source: Path) -> Path:
    """The folder beside a source that an import writes to if none is named."""
    return source.with_name(f"{source.stem}-scene")


@dataclass(frozen=True, kw_only=True)
class OwnImages:
    """Options that describe own depth images and the camera."""

    intrinsics: Annotated[tuple[str, ...], arg(metavar="FILE | FX FY CX CY")] = ()
    """JSON or YAML of BOP, Open3D, RealSense or ROS; .txt or .npy with a 3 x 3 matrix; or four numbers [px]. Default:
    from the recording."""
    depth_scale: OptionalFloat = None
    """Metres per depth unit. Default: from the file, else 0.001 for integers, 1 for floats."""
    topic: OptionalName = None
    """Topic of the depth images in a recording. Default: the only one."""
    frames: int = 1
    """Number of successive frames; the median of them is the image."""
    first: int = 0
    """Index of the first frame of a recording."""
    device: str = ""
    """Name of the camera, such as D435, or PhoXi for a structured-light scanner. Default: from the file."""
    baseline_mm: OptionalFloat = None
    """Distance between the two imagers of the camera. Default: from the table of RealSense cameras."""
    stream: Annotated[Stream | None, optional(Stream)] = None
    """raw: the depth camera's own image; aligned: resampled to another camera. Default: from the file, else raw for
    scanners, aligned for other cameras."""
    world_from_camera: Annotated[tuple[Path, ...], arg(metavar="FILE [FILE ...]")] = ()
    """JSON file with the pose of the camera (hand-eye) in a frame with the table at z = 0. One file, or one per image.
    Default: estimated from the bodies."""
    clearance_mm: OptionalFloat = None
    """Gap between a part and the walls of its cavity."""
    masks: Annotated[Masks | None, optional(Masks)] = None
    """How bodies are found: by depth alone, or corrected by networks (for a scanner by rules). Default: networks if
    torch is installed."""
    check: Annotated[tuple[float, ...], arg(metavar="MM MM MM")] = ()
    """Side lengths of a box that you placed in view; an image without a body of this size is refused."""

    def own_options(self) -> list[str]:
        """The options of own images that the user gave."""
        given = [field.name for field in fields(OwnImages) if getattr(self, field.name) != field.default]
        return [f"--{name.replace('_', '-')}" for name in given]

    def asked(
        self, sources: tuple[Path, ...], out: Path, kit: int, licence: str = "", one_scene: bool = False, **known: Any
    ) -> ImportOptions:
        """The import that these options describe. kit: which body is the kit. known: further `ImportOptions`."""
        from kit1000.capture.mask_networks import networks_available
        from kit1000.capture.options import LICENCE, ImportOptions

        values = {field.name: getattr(self, field.name) for field in fields(OwnImages)}
        masks = values.pop("masks")
        networks = masks == "networks" or (masks is None and networks_available())
        rest = known | {"networks": networks, "licence": licence or LICENCE, "one_scene": one_scene}
        return ImportOptions(sources=sources, out=out, kit=kit, **values, **rest)


@dataclass(frozen=True)
class ImportImages(OwnImages):
    """Make a folder of scenes from your own depth images: find table, kit and parts, and print their sizes."""

    sources: Annotated[Positional[tuple[Path, ...]], arg(metavar="SOURCE [SOURCE ...]")]
    """16-bit PNG or TIFF, .npy, .npz, or MCAP of ROS 2, Foxglove or ours. Several images become several scenes."""
    out: OptionalPath = None
    """Folder to write to. Default: the name of the first image with -scene."""
    kit: int = 1
    """Which body is the kit: 1 is the largest body."""
    one_scene: bool = False
    """The images show the same bodies from several places, each with its pose; registration uses all of them."""
    licence: str = ""
    """Licence of the images; it stands in the recordings."""

    def run(self) -> int:
        """Import, print the report and the folder."""
        from kit1000.capture.importing import import_scenes

        out = self.out or default_folder(self.sources[0])
        for line in import_scenes(self.asked(self.sources, out, self.kit, self.licence, self.one_scene)):
            print(line)
        print(f"{out}: open it with kit1000 edit {out}")
        return 0
