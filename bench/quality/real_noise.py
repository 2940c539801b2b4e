"""How a method does under the noise of real images: plane residuals of real depth images, put on scenes of a dataset.

    python bench/quality/real_noise.py data/kit1000 --images DIR --method registration-completed
    python bench/quality/real_noise.py data/kit1000 --images DIR --edges measured --frames 30

DIR holds depth images with `manifest.csv` (columns file, sensor, metres_a_unit, fx), as for `sensor_statistics.py`. The
residual of each image's largest plane becomes noise of the scenes' ideal images, mirrored to fill them, from a random
place of the residual. Of a camera with another focal length or baseline it is enlarged, and scaled to the same noise
in mm. Edges are sharp, or ramps, shadows, holes and units of the measured d415. The methods read nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from bench.quality.depth_images import DepthImage, read_images
from bench.quality.depth_statistics import NEAR_PLANE, disparity_of, largest_plane
from scipy.ndimage import binary_erosion, distance_transform_edt, zoom

from benchmark.intervals import wilson_interval
from kit1000.dataset.reader import Dataset
from kit1000.engines import local_engine
from kit1000.errors import InputError, Kit1000Error
from kit1000.files import write_json
from kit1000.metrics import Targets, pose_errors, seatings
from kit1000.pose import Pose
from kit1000.prediction.making import make_predictor, method_of
from kit1000.rng import stream
from kit1000.sim.measured_sensors import MEASURED_SENSORS, Conditions, DepthSensor, conditions_of, measured_view
from kit1000.values import LabelledDepth, Query

D415 = MEASURED_SENSORS["d415"]
SHARP = replace(
    D415, least_ramp_px=0.0, ramp_px=(0.0, 0.0), fattening_px=0.0, shadow_px=0, hole_share=(0.0, 0.0), units=(0.0,)
)
FOCAL = 925.0  # [px] of scenes
LEAST_SIDE = 120  # [px] of the rectangle of a plane that noise is taken from
SURE = 0.8  # confidence from which on a fit counts as sure


@dataclass(frozen=True)
class RealNoise:
    """Predict for queries under real noise, and print the share of parts seated."""

    data: tyro.conf.Positional[Path]
    """Dataset folder, with ground truth."""
    images: Path
    """Folder of real depth images with a manifest.csv."""
    names: tuple[str, ...] = ()
    """Files to take noise from; all of stereo cameras when empty."""
    method: str = "registration-completed"
    """Of the library's catalog, or module:Object."""
    track: str = "snap-d415"
    split: Literal["test", "val", "train"] = "test"
    edges: Literal["sharp", "measured"] = "measured"
    frames: int = 1
    """Number of frames of which an image is the mean: what changes from frame to frame gets smaller."""
    limit: int | None = None
    """Only the first so many queries."""
    workers: int = 1
    out: Path | None = None
    """JSON file for the rows."""


@dataclass(frozen=True)
class Answer:
    """What a method did with one query."""

    query_id: str
    motion: Pose
    confidence: float


def main(options: RealNoise) -> None:
    """Predict, measure, print."""
    images = [image for image in read_images(options.images) if "PhoXi" not in image.sensor]
    names = options.names or tuple(image.name for image in images)
    if unknown := set(names) - {image.name for image in images}:
        raise InputError(f"{options.images}: no stereo image {min(unknown)!r}")
    rows = []
    with local_engine(options.workers) as spread:
        for name in names:
            rows.append(_row(options, name, spread))
            print(_line(rows[-1]), flush=True)
    if options.out is not None:
        described = {"command": "python bench/quality/real_noise.py", "dataset_id": Dataset(options.data).id}
        write_json(options.out, described | {"rows": rows})


def _row(options: RealNoise, name: str, spread: Any) -> dict[str, Any]:
    """The scores of a method under the noise of an image."""
    dataset = Dataset(options.data)
    split = dataset.split(options.split, truth=True)
    queries = [query for query in split.queries() if query.track == options.track][: options.limit]
    jobs = [(query.scene_id, query.id) for query in queries]
    answers: Sequence[Answer] = list(spread(partial(_answer, options, name), jobs))
    truths = [split.scene(scene).truth_of(query) for scene, query in jobs]
    motions = Pose.stack([answer.motion for answer in answers])
    seated = seatings(motions, truths, dataset.geometry).seated
    errors = pose_errors(motions, Targets.of(truths, lambda part: dataset.geometry.part(part).mesh.vertices))
    sure = np.array([answer.confidence for answer in answers]) >= SURE
    low, high = wilson_interval(float(seated.mean()), len(seated))
    return {
        "image": name,
        "method": options.method,
        "track": options.track,
        "split": options.split,
        "edges": options.edges,
        "frames": options.frames,
        "noise_px": round(float(np.std(noise_field(options.images, name))), 4),
        "n": len(jobs),
        "seated": round(float(seated.mean()), 4),
        "interval": [round(low, 4), round(high, 4)],
        "position_mm": round(float(np.median(errors.position)) * 1e3, 3),
        "sure": int(sure.sum()),
        "sure_seated": int(seated[sure].sum()),
        "seated_queries": [query for (_, query), yes in zip(jobs, seated.tolist(), strict=True) if yes],
    }


def _line(row: dict[str, Any]) -> str:
    low, high = row["interval"]
    share = f"{100 * row['seated']:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"
    noise = f"{row['image']:12} {row['noise_px']:.3f} px, edges {row['edges']}, {row['frames']} frames"
    return f"{noise}: n {row['n']}, seated {share}, {row['position_mm']:.2f} mm, sure {row['sure_seated']} of {row['sure']}"


def _answer(options: RealNoise, name: str, job: tuple[str, str]) -> Answer:
    """The method's answer to a query, its image measured anew."""
    scene_id, query_id = job
    dataset, predictor = _made(options.data, options.method)
    scene = dataset.split(options.split).scene(scene_id)
    query = next(query for query in scene.queries if query.id == query_id)
    ideal = scene.labelled_depth("ideal")
    rng = stream(0, "real-noise", name, scene_id)
    sensor = D415 if options.edges == "measured" else SHARP
    field = filled(noise_field(options.images, name), ideal.view.depth.shape, rng)
    conditions = conditions_of(sensor, rng, options.frames)
    view = measured_view(sensor, ideal.view, conditions, rng, field * _left(sensor, conditions))
    image = LabelledDepth(view, ideal.labels)
    predicted = predictor(replace(query, read_image=lambda: image), None)
    return Answer(query_id, predicted.goal_from_now, float(predicted.confidence))


def _left(sensor: DepthSensor, conditions: Conditions) -> float:
    """The share of the noise's RMS that the mean of the frames leaves."""
    return conditions.left_px / replace(conditions, frames=1).left_px


@cache
def _made(data: Path, method: str) -> tuple[Dataset, Any]:
    dataset = Dataset(data)
    return dataset, make_predictor(method_of(method), dataset, 0)


@cache
def noise_field(folder: Path, name: str) -> np.ndarray:
    """(h, w) [px] of the d415 at the focal length of scenes: the residual of an image's largest plane, on a rectangle."""
    image = next(image for image in read_images(folder) if image.name == name)
    residual = plane_residual(image)
    enlarged = zoom(residual, FOCAL / image.fx, order=1) if abs(image.fx / FOCAL - 1) > 0.02 else residual
    return enlarged * (FOCAL * D415.baseline) / image.gain


def plane_residual(image: DepthImage) -> np.ndarray:
    """(h, w) [px] what a real image's largest plane has of noise and bending, on the largest rectangle without bodies."""
    d = disparity_of(image.depth, image.gain)
    residual = d - largest_plane(d)
    off = ~(np.abs(np.nan_to_num(residual, nan=0.0)) < NEAR_PLANE)
    bodies = distance_transform_edt(~binary_erosion(off, np.ones((5, 5)))) < 12
    usable = np.isfinite(residual) & ~bodies
    whole = np.where(usable, residual, np.nan)
    rows, columns = largest_rectangle(~bodies & _nearly(np.isfinite(residual)))
    inside = whole[rows, columns]
    if min(inside.shape) < LEAST_SIDE:
        raise InputError(f"{image.name}: shows no plane of {LEAST_SIDE} x {LEAST_SIDE} px without bodies")
    nearest = distance_transform_edt(np.isnan(inside), return_distances=False, return_indices=True)
    filled_in = inside[tuple(nearest)]  # type: ignore[arg-type]
    return filled_in - filled_in.mean()


def _nearly(returned: np.ndarray) -> np.ndarray:
    """Pixels with a return within 4 px: single lost pixels do not end a rectangle."""
    return distance_transform_edt(~returned) < 4


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
