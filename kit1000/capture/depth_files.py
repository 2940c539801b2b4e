"""Depth images from files, in groups that make an image each: 16-bit PNG and TIFF, .npy, .npz, and recordings."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image, ImageSequence

from kit1000.capture.depth_frames import DepthFrame, check_size
from kit1000.capture.options import ImportOptions
from kit1000.errors import InputError, Kit1000Error, did_you_mean
from kit1000.files import LFS_ADVICE, LFS_POINTER

PICTURES = (".png", ".tif", ".tiff")
ARRAYS = (".npy", ".npz")
SUFFIXES = (*PICTURES, *ARRAYS)
RECORDINGS = (".mcap", ".mcap.zst", ".mcap.zstd")
ROSBAGS = "without ROS: pip install rosbags, then rosbags-convert --src {} --dst FOLDER --dst-storage mcap"
ADVICE = {
    ".db3": "a ROS 2 bag in SQLite is not read; convert it, " + ROSBAGS.format("ITS-FOLDER"),
    ".bag": "a ROS 1 bag is not read; convert it, "
    + ROSBAGS.format("FILE.bag")
    + "; of the RealSense viewer: rs-convert -i FILE.bag -p depth",
    ".ply": "a point cloud is not read: save depth as .npy, of an organised cloud its z",
    ".pcd": "a point cloud is not read: save depth as .npy, of an organised cloud its z",
    ".zdf": "a point cloud of Zivid is not read: save its z as .npy",
    ".exr": "save depth as .npy or TIFF",
    ".jpg": "JPEG holds 8 bits: save depth as 16-bit PNG",
    ".jpeg": "JPEG holds 8 bits: save depth as 16-bit PNG",
    ".zst": "a compressed file is not read: unpack it with zstd -d",
    ".zstd": "a compressed file is not read: unpack it with zstd -d",
}
MODES = {"I;16", "I;16B", "I;16L", "I;16N", "I", "F"}  # of Pillow, with one channel and more than 8 bits
NAMES = ("depth", "depth_image", "depths", "image", "arr_0")
"""Names of a depth image among several arrays of a .npz, in this order."""
MOST_BYTES = 2_000_000_000
MOST_FRAMES = 1000  # of a file


def read_groups(sources: Sequence[Path], options: ImportOptions) -> list[list[DepthFrame]]:
    """The frames of each scene: of each recording one group, of files one for each `frames` of them.

    Args:
        sources: files and folders.
        options: which say what frames are taken; their own sources are not read.

    Raises:
        InputError: a source cannot be read.
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
    if source.is_dir():
        found = sorted(path for path in source.iterdir() if path.name.lower().endswith(RECORDINGS))
        if len(found) == 1:
            return found[0]
        if found:
            raise InputError(f"{source}: holds {len(found)} MCAP files; name one of them")
        bags = (path.suffix for path in sorted(source.iterdir()) if path.suffix in (".db3", ".bag"))
        other = ADVICE.get(next(bags, ""))
        expected = f"name files: {', '.join((*SUFFIXES, *RECORDINGS))}"
        raise InputError(f"{source}: a folder without an MCAP file; {other or expected}")
    return source if source.name.lower().endswith(RECORDINGS) and source.is_file() else None


def _image_file(source: Path) -> Path:
    if not source.is_file():
        near = [path.name for path in source.parent.iterdir()] if source.parent.is_dir() else []
        raise InputError(f"{source}: no such file; {did_you_mean(source.name, near)}".rstrip("; "))
    suffix = source.suffix.lower()
    if suffix not in SUFFIXES:
        name = f"{suffix} is not read" if suffix else "a file without suffix is not read"
        expected = f"{name}; expected {', '.join((*SUFFIXES, *RECORDINGS))}"
        raise InputError(f"{source}: {ADVICE.get(suffix, expected)}")
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
    """The frames of a file: one, or several where an array is (n, H, W) or a TIFF has pages.

    Raises InputError with one line for anything that is no depth image.
    """
    if path.stat().st_size > MOST_BYTES:
        raise InputError(f"{path}: {path.stat().st_size / 1e9:.1f} GB, expected one depth image")
    values = _picture(path) if path.suffix.lower() in PICTURES else _array(path)
    if values.ndim == 3 and values.shape[-1] > 4 and 0 < values.shape[0] <= MOST_FRAMES:
        return [DepthFrame(frame, f"{path}, frame {i}") for i, frame in enumerate(values)]
    return [DepthFrame(values, str(path))]


def _picture(path: Path) -> np.ndarray:
    """The pixels (H, W) of a picture, or (n, H, W) of one with n pages, after a look at its header alone."""
    with _one_line(path, "save the image again"), Image.open(path) as picture:
        if picture.mode not in MODES:
            bands = len(picture.getbands())
            what = f"{bands} channels" if bands > 1 else "8 bits a pixel"
            raise InputError(f"{path}: {what}, expected one of 16 bits or of floats: a picture, not depths")
        pages = int(getattr(picture, "n_frames", 1))
        check_size(picture.size[::-1], str(path))
        if pages > MOST_FRAMES or pages * picture.width * picture.height * 4 > MOST_BYTES:
            raise InputError(
                f"{path}: {pages} pages, expected at most {MOST_FRAMES} of {MOST_BYTES // 10**9} GB together"
            )
        if pages == 1:
            return np.asarray(picture)
        return _same_size([np.array(page) for page in ImageSequence.Iterator(picture)], path)


def _same_size(pages: list[np.ndarray], path: Path) -> np.ndarray:
    """(n, H, W) the pages of a picture."""
    if len({page.shape for page in pages}) > 1:
        raise InputError(f"{path}: pages of several sizes: save the depth image alone")
    return np.stack(pages)


def _array(path: Path) -> np.ndarray:
    """The array of a .npy, or the depth among those of a .npz. Nothing pickled is loaded."""
    with _one_line(path, "save the array again with numpy.save"):
        loaded = np.load(path, allow_pickle=False, mmap_mode="r" if path.suffix.lower() == ".npy" else None)
        if isinstance(loaded, np.ndarray):
            return np.array(loaded)
        with loaded:
            names = [name for name in NAMES if name in loaded.files]
            if not names and len(loaded.files) != 1:
                held = ", ".join(loaded.files) or "nothing"
                raise InputError(f"{path}: holds {held}; expected an array named depth")
            return loaded[names[0] if names else loaded.files[0]]


@contextmanager
def _one_line(path: Path, fix: str) -> Iterator[None]:
    """Any exception that damaged bytes raise in libraries becomes an InputError with one line, and warnings nothing."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except Kit1000Error:
        raise
    except Exception as error:
        text = " ".join(str(error).split())[:160] or type(error).__name__
        raise InputError(f"{path}: cannot be read: {text}; {fix}") from None
