"""How a method does under the noise of real images: plane residuals of real depth images, put on scenes of a dataset.

    python bench/quality/real_noise.py data/kit1000 --images DIR --method registration-completed
    python bench/quality/real_noise.py data/kit1000 --images DIR --frames 1 30 --weights runs/new
    python bench/quality/real_noise.py data/kit1000 --images DIR --simulated

DIR holds depth images with `manifest.csv` (columns file, sensor, metres_a_unit, fx), as for `sensor_statistics.py`. The
residual of each image's largest plane becomes noise of the scenes' ideal images, mirrored to fill them, from a random
place of the residual. Of a camera with another focal length or baseline it is enlarged, and scaled to the same noise
in mm. Edges are sharp, or ramps, shadows, holes and units of the d415. The methods read nothing else. With --simulated,
each row has one beside it under the noise and bending of the simulated d415, of the same RMS.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product, starmap
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import tyro
from scipy.ndimage import binary_erosion, distance_transform_edt, zoom

from bench.quality.depth_images import DepthImage, read_images
from bench.quality.depth_statistics import NEAR_PLANE, disparity_of, largest_plane
from benchmark.compare import mcnemar_p
from benchmark.measurements import Column, Measurement, Table, rate
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.errors import InputError, Kit1000Error
from kit1000.metrics import Targets, pose_errors, seatings
from kit1000.parallel import local_engine
from kit1000.pose import Pose
from kit1000.prediction.making import make_predictor, method_of
from kit1000.rng import stream
from kit1000.sim.sensors import SENSORS, conditions_of, measured_view
from kit1000.values import LabelledDepth

D415 = SENSORS["d415"]
SHARP = replace(
    D415, least_ramp_px=0.0, ramp_px=(0.0, 0.0), fattening_px=0.0, shadow_px=0, hole_share=(0.0, 0.0), units=(0.0,)
)
FOCAL = 925.0  # [px] of scenes
LEAST_SIDE = 120  # [px] of the rectangle of a plane that noise is taken from
BESIDE_BODIES = 12  # [px] of other surfaces, which do not count as the plane
LOST = 4  # [px] from a return, within which pixels without one do not end a rectangle
SURE = 0.8  # confidence from which on a fit counts as sure


@dataclass(frozen=True)
class RealNoise:
    """Predict for queries under real noise, and print the share of parts seated."""

    data: tyro.conf.Positional[Path]
    """Dataset folder, with ground truth."""
    images: Path
    """Folder of real depth images with a manifest.csv."""
    names: tuple[str, ...] = ()
    """Files to take noise from, without suffix; all that show a large enough plane when empty."""
    method: str = "registration-completed"
    """Name in the library's catalog, or module:Object."""
    weights: tuple[Path, ...] = ()
    """Folders with other weights of the method's networks, each compared with the shipped ones."""
    track: str = "snap-d415"
    split: Literal["test", "val", "train"] = "test"
    edges: Literal["sharp", "d415"] = "d415"
    frames: tuple[int, ...] = (1,)
    """Numbers of frames, of which an image is the mean: what changes from frame to frame gets smaller."""
    simulated: bool = False
    """Whether to compare with simulated noise of the same RMS."""
    limit: int | None = None
    """Only the first so many queries."""
    workers: int = 1
    out: Path | None = None
    """JSON file for the table, such as results/real-noise.json."""


class Noise(NamedTuple):
    """What noise an image gets."""

    image: str
    """Name of the real image that it is taken from."""
    frames: int
    """Number of frames of which the noisy image is the mean."""
    simulated: bool = False
    """Whether it is the d415's own, of the RMS of the real one."""


class Answer(NamedTuple):
    """What a method did with one query."""

    query_id: str
    motion: Pose
    confidence: float


class Outcome(NamedTuple):
    """What became of the answers to n queries."""

    seated: np.ndarray
    """(n,) bool"""
    position: np.ndarray
    """(n,) [m]"""
    sure: np.ndarray
    """(n,) bool"""


COLUMNS = (
    Column("image", "noise of"),
    Column("noise", "RMS px", 3),
    Column("edges", "edges"),
    Column("frames", "frames"),
    Column("weights", "weights"),
    Column("n", "n"),
    Column("seated", "seated, %", 1, True),
    Column("position", "position, median mm", 2),
    Column("won", "won"),
    Column("lost", "lost"),
    Column("p", "p (McNemar)", 3),
    Column("sure", f"confidence {SURE} or more"),
    Column("sure_seated", "seated of these"),
)


def main(options: RealNoise) -> None:
    """Predict, measure, print."""
    dataset = Dataset(options.data)
    measurement = Measurement.begin(dataset)
    measurement.setting["command"] = measurement.setting["command"].replace(str(options.images), "IMAGES")
    title = f"{options.method} on {options.track} of {options.split}, images with the noise of real ones"
    table = measurement.table("real-noise", title, *COLUMNS)
    with local_engine(options.workers) as spread:
        for noise in starmap(Noise, product(options.names or usable_names(options.images), options.frames)):
            first = None
            others = [noise._replace(simulated=True)] if options.simulated else []
            for each, weights in ((noise, None), *product(others, [None]), *product([noise], options.weights)):
                found = _outcome(options, dataset, each, weights, spread)
                _add(table, options, each, weights, found, first)
                first = first or found
    measurement.report(options.out)


def usable_names(folder: Path) -> list[str]:
    """The names of the stereo images that show a plane large enough."""
    names = []
    for image in read_images(folder):
        if image.kind != "PhoXi":
            with suppress(InputError):
                plane_residual(image)
                names.append(image.name)
    return names


def _add(
    table: Table, options: RealNoise, noise: Noise, weights: Path | None, found: Outcome, first: Outcome | None
) -> None:
    """Add the row of a noise and of weights, beside that of the real noise and the shipped weights."""
    values: dict[str, Any] = {}
    if first is not None:
        won, lost = int((found.seated & ~first.seated).sum()), int((first.seated & ~found.seated).sum())
        values = {"won": won, "lost": lost, "p": mcnemar_p(won, lost)}
    table.add(
        image=f"{noise.image}, simulated" if noise.simulated else noise.image,
        noise=float(np.std(noise_field(options.images, noise.image))),
        edges=options.edges,
        frames=noise.frames,
        weights="shipped" if weights is None else weights.name,
        n=len(found.seated),
        seated=rate(found.seated),
        position=1e3 * float(np.median(found.position)),
        sure=int(found.sure.sum()),
        sure_seated=int((found.sure & found.seated).sum()),
        **values,
    )


def _outcome(options: RealNoise, dataset: Dataset, noise: Noise, weights: Path | None, spread: Any) -> Outcome:
    """What becomes of a method's answers under a noise."""
    split = dataset.split(options.split, truth=True)
    queries = [query for query in split.queries() if query.track == options.track][: options.limit]
    if not queries:
        raise InputError(f"{options.data}: split {options.split} has no query of {options.track}")
    jobs = [(query.scene_id, query.id) for query in queries]
    answers = {answer.query_id: answer for answer in spread(partial(_answer, options, noise, weights), jobs)}
    truths = [split.scene(scene).truth_of(query) for scene, query in jobs]
    motions = Pose.stack([answers[query].motion for _, query in jobs])
    errors = pose_errors(motions, Targets.of(truths, lambda part: dataset.geometry.part(part).mesh.vertices))
    sure = np.array([answers[query].confidence for _, query in jobs]) >= SURE
    return Outcome(seatings(motions, truths, dataset.geometry).seated, errors.position, sure)


def _answer(options: RealNoise, noise: Noise, weights: Path | None, job: tuple[str, str]) -> Answer:
    """The method's answer to a query, its image measured anew."""
    scene_id, query_id = job
    dataset, predictor = _made(options.data, options.method, weights)
    scene = dataset.split(options.split).scene(scene_id)
    query = next(query for query in scene.queries if query.id == query_id)
    image = noisy_image(options, noise, scene)
    predicted = predictor(replace(query, read_image=lambda: image), None)
    return Answer(query_id, predicted.goal_from_now, float(predicted.confidence))


def noisy_image(options: RealNoise, noise: Noise, scene: RecordedScene) -> LabelledDepth:
    """The ideal image of a scene with the noise of a real one; always the same."""
    ideal = scene.labelled_depth("ideal")
    rng = stream(0, "real-noise", noise.image, scene.id)
    sensor = D415 if options.edges == "d415" else SHARP
    real = noise_field(options.images, noise.image)
    field = filled(real, ideal.view.depth.shape, rng)
    conditions = conditions_of(sensor, rng, noise.frames)
    if noise.simulated:  # under the same conditions and errors of the camera: `rng` has drawn as for the real noise
        louder = float(np.std(real)) / math.hypot(conditions.noise_px, conditions.bending_px)
        amplitude = {name: louder * getattr(conditions, name) for name in ("noise_px", "bending_px")}
        view = measured_view(sensor, ideal.view, replace(conditions, **amplitude), rng)
        return LabelledDepth(view, ideal.labels)
    left = conditions.left_px / replace(conditions, frames=1).left_px  # of the RMS, in the mean of the frames
    return LabelledDepth(measured_view(sensor, ideal.view, conditions, rng, field * left), ideal.labels)


@cache
def _made(data: Path, name: str, weights: Path | None) -> tuple[Dataset, Any]:
    """A dataset and the predictor of a method, with the weights of a folder where it has them."""
    dataset, method = Dataset(data), method_of(name)
    if weights is not None:
        there = {key: weights / stem.name for key, stem in method.weights.items() if _has(weights, stem.name)}
        if not there:
            raise InputError(
                f"{weights}: none of the weights of {name}, such as {next(iter(method.weights.values())).name}"
            )
        method = replace(method, weights={**method.weights, **there})
    return dataset, make_predictor(method, dataset, 0)


def _has(folder: Path, stem: str) -> bool:
    return (folder / f"{stem}.json").is_file() and (folder / f"{stem}.safetensors").is_file()


@cache
def noise_field(folder: Path, name: str) -> np.ndarray:
    """(h, w) [px] noise of an image's largest plane, as the d415 has it at the focal length of scenes."""
    image = next(image for image in read_images(folder) if image.name == name)
    residual = plane_residual(image)
    enlarged = np.asarray(zoom(residual, FOCAL / image.fx, order=1)) if abs(image.fx / FOCAL - 1) > 0.02 else residual
    return enlarged * (FOCAL * D415.baseline) / image.gain


def plane_residual(image: DepthImage) -> np.ndarray:
    """(h, w) [px] noise and bending of an image's largest plane, on the largest rectangle without bodies."""
    d = disparity_of(image.depth, image.gain)
    residual = d - largest_plane(d)
    off = ~(np.abs(np.nan_to_num(residual, nan=0.0)) < NEAR_PLANE)
    core = np.asarray(binary_erosion(off, np.ones((5, 5))), bool)
    bodies = _within(core, BESIDE_BODIES)
    usable = np.isfinite(residual) & ~bodies
    whole = np.where(usable, residual, np.nan)
    rows, columns = largest_rectangle(~bodies & _within(np.isfinite(residual), LOST))
    inside = whole[rows, columns]
    if min(inside.shape) < LEAST_SIDE:
        raise InputError(f"{image.name}: shows no plane of {LEAST_SIDE} x {LEAST_SIDE} px without bodies")
    nearest = distance_transform_edt(np.isnan(inside), return_distances=False, return_indices=True)
    filled_in = inside[tuple(nearest)]  # type: ignore[arg-type]
    return filled_in - filled_in.mean()


def _within(mask: np.ndarray, reach: float) -> np.ndarray:
    """(H, W) bool: pixels less than `reach` px from one of a mask (H, W)."""
    return np.asarray(distance_transform_edt(~mask)) < reach


def largest_rectangle(mask: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of the largest rectangle of true pixels of a mask (H, W): by the stack of rising heights."""
    best, found = 0, (slice(0, 0), slice(0, 0))
    heights = np.zeros(mask.shape[1] + 1, int)
    for v, row in enumerate(mask):
        heights[:-1] = np.where(row, heights[:-1] + 1, 0)
        stack: list[int] = []
        for u, height in enumerate(heights.tolist()):
            while stack and heights[stack[-1]] >= height:
                tall = int(heights[stack.pop()])
                left = stack[-1] + 1 if stack else 0
                if tall * (u - left) > best:
                    best, found = tall * (u - left), (slice(v + 1 - tall, v + 1), slice(left, u))
            stack.append(u)
    return found


def filled(field: np.ndarray, shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """(H, W): a field mirrored at its borders again and again, from a random place on, flipped or not."""
    flips = rng.integers(2, size=2)
    field = field[:: 1 - 2 * int(flips[0]), :: 1 - 2 * int(flips[1])]
    whole = np.concatenate([field, field[::-1]])
    whole = np.concatenate([whole, whole[:, ::-1]], 1)
    starts = rng.integers(whole.shape)
    v, u = (np.arange(n) + start for n, start in zip(shape, starts, strict=True))
    return whole[v[:, None] % whole.shape[0], u % whole.shape[1]]


if __name__ == "__main__":
    try:
        main(tyro.cli(RealNoise))
    except Kit1000Error as error:
        raise SystemExit(f"real_noise: {error}") from error
