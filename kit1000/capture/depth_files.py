"""Depth images from files, in groups that make an image each: 16-bit PNG and TIFF, .npy, .npz, and recordings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from kit1000.capture.depth_frames import DepthFrame, check_size
from kit1000.capture.options import ImportOptions
from kit1000.errors import InputError, Kit1000Error, did_you_mean
from kit1000.files import LFS_ADVICE, LFS_POINTER

PICTURES = (".png", ".tif", ".tiff")
SUFFIXES = (*PICTURES, ".npy", ".npz")
RECORDING = ".mcap"
BAGS = (".db3", ".bag")
PACKED = (".zst", ".zstd")
ROSBAGS = "convert it without ROS: pip install rosbags, rosbags-convert --src IT --dst FOLDER --dst-storage mcap"
MODES = {"I;16", "I;16B", "I;16L", "I;16N", "I", "F"}  # of Pillow, with one channel and more than 8 bits
MOST_BYTES = 2_000_000_000
MOST_FRAMES = 1000  # of a file


def read_groups(sources: Sequence[Path], options: ImportOptions) -> list[list[DepthFrame]]:
    """The frames of each scene: of each recording one group, of files one for each `frames` of them.

    sources: files and folders; those of the options are not read. Raises InputError if one cannot be read.
    """
    groups: list[list[DepthFrame]] = []
    single: list[DepthFrame] = []
    for source in sources:
        found = _recording(source)
        if found is not None:
            from kit1000.capture.recordings import read_recording

            groups.append(read_recording(_checked_file(found), options))
            continue
        image = _checked_file(_image_file(source))
        if options.topic is not None or options.first:
            raise InputError(f"{image}: an image: --topic and --first choose among the images of recordings")
        frames = read_depth_files(image)
        if len(frames) > 1:
            groups.append(frames)
        else:
            single += frames
    count = options.frames
    if single and len(single) % count:
        raise InputError(f"--frames {count}: {len(single)} images do not make groups of {count}")
    groups += [single[i : i + count] for i in range(0, len(single), count)]
    return groups


def _recording(source: Path) -> Path | None:
    """The MCAP file of a source, or of a ROS 2 bag, which is a folder; None for anything else."""
    if not source.is_dir():
        return source if source.suffix.lower() == RECORDING and source.is_file() else None
    found = sorted(path for path in source.iterdir() if path.suffix.lower() == RECORDING)
    if len(found) == 1:
        return found[0]
    if found:
        raise InputError(f"{source}: holds {len(found)} MCAP files; name one of them")
    bag = any(path.suffix in BAGS for path in source.iterdir())
    advice = ROSBAGS if bag else f"name files: {', '.join((*SUFFIXES, RECORDING))}"
    raise InputError(f"{source}: a folder without an MCAP file; {advice}")


def _image_file(source: Path) -> Path:
    if not source.is_file():
        near = [path.name for path in source.parent.iterdir()] if source.parent.is_dir() else []
        raise InputError(f"{source}: no such file; {did_you_mean(source.name, near)}".rstrip("; "))
    suffix = source.suffix.lower()
    if suffix not in SUFFIXES:
        advice = "save depth as 16-bit PNG or .npy, of a point cloud its z"
        if suffix in BAGS:
            advice = ROSBAGS
        elif suffix in PACKED:
            advice = "unpack it by zstd -d"
        raise InputError(
            f"{source}: {suffix or 'no suffix'} is not read, expected {', '.join((*SUFFIXES, RECORDING))}: {advice}"
        )
    return source


def _checked_file(path: Path) -> Path:
    """A file that can be read, unless git-lfs left a pointer in its place."""
    try:
        with path.open("rb") as file:
            start = file.read(len(LFS_POINTER))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if start == LFS_POINTER:
        raise InputError(f"{path}: {LFS_ADVICE}")
    return path


def read_depth_files(path: Path) -> list[DepthFrame]:
    """The frames of a file: one, or several of an array (n, H, W). Nothing pickled is loaded.

    Raises InputError with one line for anything that is no depth image.
    """
    if path.stat().st_size > MOST_BYTES:
        raise InputError(f"{path}: {path.stat().st_size / 1e9:.1f} GB, expected one depth image")
    try:
        values = _picture(path) if path.suffix.lower() in PICTURES else _array(path)
    except Kit1000Error:
        raise
    except Exception as error:  # damaged bytes raise anything in libraries
        text = " ".join(f"{type(error).__name__} {error}".split())[:160]
        raise InputError(f"{path}: cannot be read: {text}; save the image again") from None
    if values.ndim == 3 and values.shape[-1] > 4 and 0 < values.shape[0] <= MOST_FRAMES:
        return [DepthFrame(frame, f"{path}, frame {i}") for i, frame in enumerate(values)]
    return [DepthFrame(values, str(path))]


def _picture(path: Path) -> np.ndarray:
    """The pixels (H, W) of a picture, after a look at its header alone."""
    with Image.open(path) as picture:
        if picture.mode not in MODES:
            bands = len(picture.getbands())
            what = f"{bands} channels" if bands > 1 else "8 bits a pixel"
            raise InputError(f"{path}: {what}, expected one of 16 bits or of floats: a picture, not depths")
        if getattr(picture, "n_frames", 1) > 1:
            raise InputError(f"{path}: several pages: save each in a file, and give --frames")
        check_size(picture.size[::-1], str(path))
        return np.asarray(picture)


def _array(path: Path) -> np.ndarray:
    """The array of a .npy; of a .npz the one named depth, or the only one."""
    loaded = np.load(path, allow_pickle=False)
    if isinstance(loaded, np.ndarray):
        return loaded
    names = ["depth"] if "depth" in loaded.files else loaded.files
    if len(names) != 1:
        raise InputError(f"{path}: holds {', '.join(names) or 'nothing'}; expected an array named depth")
    return loaded[names[0]]
