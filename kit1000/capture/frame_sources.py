"""Where frames come from: files of one image, or recordings of many."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from kit1000.capture.depth_files import SUFFIXES, read_depth_files
from kit1000.capture.depth_frames import DepthFrame
from kit1000.capture.frame_selection import Selection
from kit1000.errors import InputError, did_you_mean
from kit1000.files import LFS_ADVICE, LFS_POINTER

RECORDINGS = (".mcap",)
ADVICE = {
    ".db3": "convert it: ros2 bag convert -i FOLDER -o OPTIONS.yaml with storage_id: mcap",
    ".bag": "record in MCAP, or save images: a bag of ROS 1 or of the RealSense viewer is not read",
    ".ply": "save depth as .npy: of an organised cloud its z",
    ".pcd": "save depth as .npy: of an organised cloud its z",
    ".zdf": "save depth as .npy: of the point cloud its z",
    ".exr": "save depth as .npy or TIFF",
    ".jpg": "JPEG holds 8 bits: save depth as 16-bit PNG",
    ".jpeg": "JPEG holds 8 bits: save depth as 16-bit PNG",
}


def read_groups(sources: Sequence[Path], selection: Selection) -> list[list[DepthFrame]]:
    """The frames of each scene: of each recording one group, of files one for each `frames` of them.

    Raises InputError for a source that cannot be read.
    """
    groups: list[list[DepthFrame]] = []
    single: list[DepthFrame] = []
    for source in sources:
        found = _recording(source)
        if found is not None:
            from kit1000.capture.recordings import read_recording

            groups.append(read_recording(_whole(found), selection))
            continue
        image = _whole(_image_file(source))
        if selection.topic is not None or selection.first:
            raise InputError(f"{image}: an image, of which --topic and --first choose nothing: they are of recordings")
        frames = read_depth_files(image)
        if len(frames) > 1:
            groups.append(frames)
        else:
            single += frames
    count = selection.frames
    if single and len(single) % count:
        raise InputError(f"--frames {count}: {len(single)} images do not make groups of {count}")
    groups += [single[i : i + count] for i in range(0, len(single), count)]
    return groups


def _recording(source: Path) -> Path | None:
    """The MCAP file of a source, or of a ROS 2 bag, which is a folder; None for anything else."""
    if source.is_dir():
        found = sorted(source.glob("*.mcap"))
        if len(found) == 1:
            return found[0]
        if found:
            raise InputError(f"{source}: holds {len(found)} MCAP files; name one of them")
        other = next(iter(sorted(source.glob("*.db3"))), None)
        advice = ADVICE[".db3"] if other else f"name files: {', '.join((*SUFFIXES, *RECORDINGS))}"
        raise InputError(f"{source}: a folder without an MCAP file; {advice}")
    return source if source.suffix.lower() in RECORDINGS and source.is_file() else None


def _image_file(source: Path) -> Path:
    if not source.is_file():
        near = [path.name for path in source.parent.iterdir()] if source.parent.is_dir() else []
        raise InputError(f"{source}: no such file; {did_you_mean(source.name, near)}".rstrip("; "))
    suffix = source.suffix.lower()
    if suffix not in SUFFIXES:
        advice = ADVICE.get(suffix, f"expected {', '.join((*SUFFIXES, *RECORDINGS))}")
        raise InputError(f"{source}: {suffix or 'a file without suffix'} is not read; {advice}")
    return source


def _whole(path: Path) -> Path:
    """A file, unless git-lfs left a pointer in its place."""
    try:
        with path.open("rb") as file:
            start = file.read(len(LFS_POINTER))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if start == LFS_POINTER:
        raise InputError(f"{path}: {LFS_ADVICE}")
    return path
