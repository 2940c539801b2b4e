"""Would the tests notice a wrong line? Changes one line at a time and runs the tests of its module: `make mutants`.

Each change is made in a copy of the tree, never in the checkout. A change that no test notices has survived; the exit
status is 1 when fewer than LEAST_SHARE of them die.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
LEAST_SHARE = 0.95
TIMEOUT = 600  # [s] a change that makes the tests run on and on is noticed
COPIED = ("kit1000", "benchmark", "baselines", "bench", "tests", "pyproject.toml")
NOT_COPIED = shutil.ignore_patterns("*.safetensors", "*.pyc")
NEWER = 1000  # [s] by which a changed file is newer than before, so that no compiled code of it is used
FAILED, PASSED = 1, 0  # exit statuses of pytest


class Mutant(NamedTuple):
    """A change of one line and the tests that should notice it."""

    file: str
    old: str
    """Occurs once in the file."""
    new: str
    tests: str
    """Test files below tests/, without test_ and .py: `kits/seating` for tests/kits/test_seating.py."""

    @property
    def name(self) -> str:
        """Place and change, in one line."""
        return f"{self.file}: {self.old} -> {self.new}"

    @property
    def test_files(self) -> list[str]:
        """Paths of the test files."""
        parts = [name.rpartition("/") for name in self.tests.split()]
        return [f"tests/{folder}{slash}test_{name}.py" for folder, slash, name in parts]


CHANGES: dict[tuple[str, str], tuple[tuple[str, str], ...]] = {
    ("kit1000/metrics/pose_errors.py", "metrics/pose_errors"): (
        ("return 2 * np.arctan2(np.sum(relative", "return np.arctan2(np.sum(relative"),
        ("angle - 2 * np.pi * np.round(angle / (2 * np.pi)), mssd", "angle, mssd"),
        ("(predicted, targets.goals_drawn, targets.anchors)", "(predicted, goal_motions, targets.anchors)"),
        ("predicted.apply(anchors) - goals.apply(anchors)", "predicted.xyz - goals.xyz"),
        ("targets.goals @ targets.world_from_part[query]", "targets.goals"),
    ),
    ("kit1000/metrics/nearest_goal.py", "metrics/pose_errors"): (
        ("dx * dx + dy * dy + dz * dz", "dx * dx + dy * dy"),
        ("if at_found < at_twist else", "if at_found > at_twist else"),
        ("ANGLE_SAMPLES = 24", "ANGLE_SAMPLES = 3"),
        ("GOLDEN_STEPS = 30", "GOLDEN_STEPS = 8"),
        ("rotated_t[i] = point[i]", "rotated_t[i] = 0.0"),
    ),
    ("kit1000/metrics/seating.py", "metrics/seating"): (
        ("extent[:2] / 2", "extent[:2] * 0.9"),
        ('"near": 0.1e-3', '"near": 0.01e-3'),
        ("xyz + (offset if np.isfinite(offset) else 0.0) * axis", "xyz"),
        ("goals.inverse().rotate(UP)", "poses.inverse().rotate(UP)"),
        ("if not is_rotation_seated(trial.kit_from_part, trial.goal, trial.truth.slot.clearance):", "if False:"),
        ("(closed.seated, closed.strict) != (final.seated, final.strict)", "closed.seated != final.seated"),
    ),
    ("kit1000/metrics/exact_seating.py", "metrics/seating stated_numbers"): (
        ("path = (HOVER + along.max() - along.min()) * axis", "path = HOVER / 2 * axis"),
        ("at_most(interval.high) and not at_most(interval.low)", "at_most(interval.high)"),
        ("min(limit, depth / 3) - BISECTION_STEP", "limit - BISECTION_STEP"),
        ("max(-far, ends[0])", "ends[0]"),
    ),
    ("kit1000/metrics/targets.py", "metrics/pose_errors"): (
        ("(np.diff(starts) < 1).any()", "(np.diff(starts) < 0).any()"),
        ("np.repeat(self.goal_starts[:-1][rows] - starts[:-1], counts)", "np.repeat(starts[:-1], counts)"),
    ),
    ("kit1000/metrics/volumes.py", "metrics/volumes"): (
        ("~np.isnan(left) & ~np.isnan(right)", "~np.isnan(left)"),
        ("float(to_right.mean() + to_left.mean()) / 2", "float(to_right.mean())"),
        ("known = ~np.isnan(right)", "known = ~np.isnan(left)"),
    ),
    ("kit1000/pose.py", "pose quaternions"): (
        ("first = 0.5 * _sinc(angle / 2) ** 2", "first = 0.5 * _sinc(angle / 2)"),
        ("np.where(w < 0, -self.wxyz[..., 1:], self.wxyz[..., 1:])", "self.wxyz[..., 1:]"),
        ("np.where(cosine >= 0, _half_way", "np.where(cosine >= -2, _half_way"),
        ("or np.any(determinant(matrix) < 0)", "or False"),
    ),
    ("kit1000/symmetry.py", "symmetry"): (
        ("np.cross(axis, v), axis=-1), np.hypot(w, along)", "np.cross(axis, v), axis=-1), np.abs(w)"),
        ("int(np.ceil(2 * np.pi / step - GROUP_TOLERANCE))", "int(np.ceil(2 * np.pi / step))"),
        ("MAX_GROUP_ORDER = 120", "MAX_GROUP_ORDER = 119"),
        ("and np.any(_tilt(g, self.axis) > tol)", "and False"),
    ),
    ("kit1000/kits/seating.py", "stated_numbers kits/seating kits/kit_trials"): (
        ("SEATED_LIMIT = 3e-3", "SEATED_LIMIT = 3.1e-3"),
        ("abs(height) <= deep - BISECTION_STEP", "height <= deep - BISECTION_STEP"),
        ("deep = min(limit, depth / 3)", "deep = limit"),
        ("HOVER = 0.1 ", "HOVER = 0.05 "),
        ("ROTATION_LIMIT = np.radians(10)", "ROTATION_LIMIT = np.radians(11)"),
        ("near and passes(STRICT_LIMIT)", "passes(STRICT_LIMIT)"),
        ("WRONG_TILT = np.radians(20)", "WRONG_TILT = np.radians(22)"),
    ),
    ("kit1000/kits/contact.py", "kits/contact"): (
        ("facing[adjacent] > -WALL_COSINE).any(1)", "facing[adjacent] > -WALL_COSINE).all(1)"),
        ("    best = highest_vertex_contact(fixed.vertices, moving.faces, -1.0, best, enough)\n", ""),
    ),
    ("kit1000/mesh.py", "kits/contact"): (("along) > COPLANAR_SINE", "along) > 0.5"),),
    ("kit1000/kits/cavity.py", "kits/cavity"): (
        ("return min(20e-3, 0.6 * height,", "return min(25e-3, 0.6 * height,"),
        ("MIN_WALL = 3e-3", "MIN_WALL = 3.5e-3"),
        ("(below + z) / 2 if probes else 0.0", "0.0"),
        ("removed = removed + thin", "removed = thin"),
    ),
    ("kit1000/kits/goals.py", "stated_numbers kits/goals"): (
        ("max_angle or 0.0), SEATED_LIMIT / 3)", "max_angle or 0.0), SEATED_LIMIT)"),
        ("SHADOW_TOLERANCE = 0.05e-3", "SHADOW_TOLERANCE = 0.06e-3"),
        ("range(36, 1, -1)", "range(4, 1, -1)"),
        (
            "z)\n        if not (_within_tolerance(section, other) and _within_tolerance(other, section))",
            "z)\n        if not (_within_tolerance(section, other))",
        ),
        ("2 * np.arctan2(matmul(wxyz[", "np.arctan2(matmul(wxyz["),
        ("nearest.wxyz) < most_angle", "nearest.wxyz) < 4.0"),
    ),
    ("kit1000/kits/kit_trials.py", "kits/kit_trials"): (
        ("kit, goal, goal).strict", "kit, goal, goal).seated"),
        ("for sign in (1, -1) if", "for sign in (1,) if"),
    ),
    ("kit1000/kits/loose_fits.py", "kits/loose_fits"): (
        ("MOST_TILT = np.radians(5)", "MOST_TILT = np.radians(9)"),
        ("-xx * s + xy * c", "xx * s + xy * c"),
        ("for sign in (1.0, -1.0):\n        start", "for sign in (1.0,):\n        start"),
        ("TURNED_SHARE = 1.0001", "TURNED_SHARE = 1.2"),
    ),
    ("kit1000/sim/sensors.py", "stated_numbers sim/sensors"): (
        ("amplitude_px=(0.10, 0.30)", "amplitude_px=(0.14, 0.42)"),
        ("amplitude_px=(0.045, 0.062)", "amplitude_px=(0.06, 0.085)"),
        ("subpixel_px=1 / 32", "subpixel_px=1 / 16"),
        ("grazing_deg=(75.0, 87.0)", "grazing_deg=(65.0, 87.0)"),
        ("fx * sensor.baseline / sensor.convergence", "0.0"),
        ("max_depth=3.0", "max_depth=4.0"),
        ("side=-1", "side=1"),
        ("(1 - self.fixed_share) / self.frames", "(1 - self.fixed_share)"),
    ),
    ("kit1000/sim/stereo.py", "stated_numbers sim/sensors"): (
        ("EDGE_STEP = 1.0", "EDGE_STEP = 1.5"),
        ("(math.acos(cosines[u]) - start) / (end - start)", "(math.acos(cosines[u]) - start) / end"),
        ("return ahead if abs(ahead) < abs(back) else back", "return back"),
    ),
    ("kit1000/sim/depth_edges.py", "stated_numbers sim/sensors"): (
        ("np.rint(value / step) * step", "np.floor(value / step) * step"),
        ("edges[u]) & (abs(b) <= edges[u])", "edges[u]) | (abs(b) <= edges[u])"),
        ("chance[y, x] >= share", "chance[y, x] < share"),
    ),
    ("kit1000/sim/visibility.py", "stated_numbers sim/visibility"): (
        ("MIN_PART_PIXELS = 800", "MIN_PART_PIXELS = 400"),
        ("MIN_CAVITY_SHARE = 0.15", "MIN_CAVITY_SHARE = 0.05"),
        ("if z < NEAR_PLANE or distance >= 0:", "if z < NEAR_PLANE:"),
        ("RIM_MARGIN = 0.3e-3", "RIM_MARGIN = 3e-3"),
        ("np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)", "a, b"),
    ),
    ("kit1000/rng.py", "generation/withhold"): (("MIN_SECRET_ROOT = 2**127", "MIN_SECRET_ROOT = 2**64"),),
    ("kit1000/generation/withhold.py", "generation/withhold"): (
        ("SALT_BYTES = 32", "SALT_BYTES = 16"),
        ("hashlib.sha256(salt.encode() + json_bytes(files))", "hashlib.sha256(json_bytes(files))"),
        ("hashlib.sha256(salt.encode() + dataset_id.encode())", "hashlib.sha256(dataset_id.encode())"),
        ('"seed": None,', '"seed": summary["seed"],'),
    ),
    ("kit1000/dataset/scene_queries.py", "dataset/scene_queries"): (
        ("PAPER_TILT = float(np.radians(15))", "PAPER_TILT = float(np.radians(20))"),
        ("return np.maximum(np.abs(np.arctan2(y, z))", "return np.minimum(np.abs(np.arctan2(y, z))"),
        ("if part.invisibility is None]\n    pivots", "]\n    pivots"),
        ("if part.invisibility is None]\n    able", "]\n    able"),
    ),
    ("kit1000/queries/motions.py", "queries/guesses"): (
        ("arm_change = rotation.rotate(arm) - arm", "arm_change = rotation.rotate(arm)"),
        ("guess.apply(pivot) - goal_from_now.apply(pivot)", "guess.xyz - goal_from_now.xyz"),
    ),
    ("kit1000/queries/guesses.py", "stated_numbers queries/guesses"): (
        ("MAX_OFFSET = 28e-3", "MAX_OFFSET = 30e-3"),
        ("MAX_ANGLE = float(np.radians(27.5))", "MAX_ANGLE = float(np.radians(30))"),
        (
            "rng.integers(len(slot.goals)), rng.uniform(0, 2 * np.pi)",
            "rng.integers(len(slot.goals)), rng.uniform(0, 6)",
        ),
    ),
    ("kit1000/queries/pivots.py", "queries/guesses"): (
        ("(ordered[first] + ordered[last]) / 2", "points.mean(0)"),
        ("PIVOT_DECIMALS = 4", "PIVOT_DECIMALS = 3"),
        ("LEFT_OUT = 10 ", "LEFT_OUT = 5 "),
        ("EROSION = 3 ", "EROSION = 2 "),
        ("_eroded(mask) & (view.depth[box] > 0)", "_eroded(mask) & (view.depth[box] >= 0)"),
    ),
}
MUTANTS = tuple(Mutant(file, *change, tests) for (file, tests), changes in CHANGES.items() for change in changes)


def copy_tree(target: Path) -> None:
    """Copy what the tests of the mutants need into an empty folder: with compiled functions and the times of files."""
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, target / name, ignore=NOT_COPIED)
        else:
            shutil.copy2(source, target / name)


def pytest_status(tree: Path, test_files: list[str], timeout: float | None = None) -> tuple[int, str]:
    """Run test files of a copy up to the first failure: the exit status of pytest and the end of its output."""
    options = ["-x", "-q", "-p", "no:cacheprovider", "--hypothesis-seed=0", "--no-header"]
    command = [sys.executable, "-B", "-m", "pytest", *options, *test_files]
    environment = os.environ | {"PYTHONPATH": str(tree)}
    try:
        run = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, timeout=timeout)
    except subprocess.TimeoutExpired:
        return FAILED, f"no end within {timeout} s"
    shutil.rmtree(tree / ".hypothesis", ignore_errors=True)  # failing examples of one mutant would help to kill others
    return run.returncode, run.stdout[-2000:] + run.stderr[-2000:]


def is_killed(mutant: Mutant, tree: Path) -> bool:
    """Whether a test of the mutant fails in a copy of the tree; its file and what is compiled of it are restored."""
    path = tree / mutant.file
    plain, status = path.read_text(encoding="utf-8"), path.stat()
    if plain.count(mutant.old) != 1:
        raise SystemExit(f"bench/outside/mutants.py: expected once in {mutant.file}, found otherwise: {mutant.old}")
    compiled, kept = path.parent / "__pycache__", tree / "kept"
    compiled.mkdir(exist_ok=True)
    shutil.copytree(compiled, kept)
    path.write_text(plain.replace(mutant.old, mutant.new), encoding="utf-8")
    os.utime(path, (status.st_atime, status.st_mtime + NEWER))
    code, output = pytest_status(tree, mutant.test_files, TIMEOUT)
    path.write_text(plain, encoding="utf-8")
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    shutil.rmtree(compiled)
    kept.rename(compiled)
    if code not in (FAILED, PASSED):
        raise SystemExit(f"bench/outside/mutants.py: {mutant.name}: tests neither passed nor failed\n{output}")
    return code == FAILED


def main(wanted: list[str]) -> int:
    """Run the mutants whose name contains one of some words, all without words; returns the exit status."""
    mutants = [mutant for mutant in MUTANTS if not wanted or any(word in mutant.name for word in wanted)]
    if not mutants:
        raise SystemExit(f"bench/outside/mutants.py: no mutant has a name with {' or '.join(wanted)}")
    survivors = []
    with TemporaryDirectory() as folder:
        tree = Path(folder)
        copy_tree(tree)
        code, output = pytest_status(tree, sorted({name for mutant in mutants for name in mutant.test_files}))
        if code != PASSED:
            raise SystemExit(f"bench/outside/mutants.py: the tests fail without any change\n{output}")
        for mutant in mutants:
            killed = is_killed(mutant, tree)
            survivors += [] if killed else [mutant]
            print("died    " if killed else "SURVIVED", mutant.name.replace("\n", ""), flush=True)
    share = 1 - len(survivors) / len(mutants)
    print(f"{len(mutants) - len(survivors)} of {len(mutants)} died, {share:.1%}")
    print(*(f"survived: {mutant.name}" for mutant in survivors), sep="\n", end="\n" if survivors else "")
    return int(share < LEAST_SHARE)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("words", nargs="*", help="only mutants whose name contains one of these")
    sys.exit(main(parser.parse_args().words))
