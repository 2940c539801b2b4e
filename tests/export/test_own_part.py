"""Kits of own parts: true size, the requested clearance, stated repairs; of many files each a kit or a reason."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from manifold3d import Manifold, OpType
from PIL import Image

from kit1000.cli import main
from kit1000.cli.summaries import kit_report_text
from kit1000.dataset.mesh_files import read_glb
from kit1000.errors import InputError
from kit1000.export import own_part
from kit1000.export.own_part import InexactKit, KitOptions, folder_names, make_kit_from_file, make_kits
from kit1000.kits.clearance import Clearance
from kit1000.kits.height_fields import RELIEF_CELLS, lower_envelope, polar_relief
from kit1000.kits.kit import design_kit, insertion_faces
from kit1000.kits.kit_trials import NOT_SEATED, Attempt, PairCheck
from kit1000.mesh import Mesh, body_count, defect_float32, mesh_from_solid, solid_from_mesh
from kit1000.parts.family import part_of_mesh
from kit1000.parts.files.read import mesh_files, read_triangles
from kit1000.pictures import previews
from tests.samples.mini import file_hashes, l_shape, write_stl

FILES = ["kit.stl", "part.stl", "preview.png", "report.json", "seated.glb"]
DRAWN = previews.kit_preview
EXACT = 1e-5  # [mm] float32 at a tenth of a metre
MM = KitOptions(unit="mm")


def read(path: Path) -> Mesh:
    """An STL in its own unit, equal vertices merged."""
    soup = read_triangles(path)
    return Mesh(soup.vertices, soup.faces).merged()


@pytest.fixture(scope="module", autouse=True)
def _picture() -> Iterator[None]:
    """A fake preview: rendering takes longer than everything else."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(previews, "kit_preview", lambda *_: b"picture")
        yield


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("own")
    make_kit_from_file(write_stl(folder / "corner.stl", l_shape()), folder / "out")
    return folder / "out"


@pytest.fixture(scope="module")
def report(out: Path) -> dict[str, Any]:
    return json.loads((out / "report.json").read_bytes())


def test_the_preview_shows_the_part_in_its_colour(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(previews, "kit_preview", DRAWN)
    make_kit_from_file(write_stl(tmp_path / "corner.stl", l_shape()), tmp_path / "out")
    with Image.open(tmp_path / "out/preview.png") as picture:
        assert picture.size == previews.PREVIEW_SIZE
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3).astype(int)
    orange = (pixels[:, 0] - pixels[:, 2] > 60).mean()
    assert 0.02 < orange < 0.5


def test_the_seated_part_touches_only_the_floor(out: Path, report: dict[str, Any]) -> None:
    kit, part = read(out / "kit.stl"), read(out / "part.stl")
    for mesh in (kit, part):
        assert defect_float32(mesh) is None
    assert (solid_from_mesh(kit) ^ solid_from_mesh(part)).volume() < EXACT * part.area
    assert part.bounds[0, 2] == pytest.approx(-report["depth_mm"], abs=EXACT)
    assert part.bounds[1, 2] == pytest.approx(report["proud_mm"], abs=EXACT)
    assert np.isclose(kit.vertices[:, 2], -report["depth_mm"], atol=EXACT).any()


def test_files_are_in_millimetres_with_z_up_at_true_size(out: Path, report: dict[str, Any]) -> None:
    kit, part = read(out / "kit.stl"), read(out / "part.stl")
    assert sorted(part.extents) == pytest.approx([24, 30, 40], abs=EXACT)
    assert sorted(report["size_mm"]) == [24, 30, 40]
    assert (
        report["volume_mm3"] == pytest.approx(part.volume, rel=1e-6) == pytest.approx(l_shape().volume * 1e9, rel=1e-6)
    )
    assert kit.extents == pytest.approx(report["plate_mm"], abs=1e-3)
    assert kit.bounds.sum(0)[:2] == pytest.approx([0, 0], abs=EXACT)
    assert kit.bounds[1, 2] == 0


def test_the_clearance_is_the_requested_one_everywhere(out: Path, report: dict[str, Any]) -> None:
    kit, part = solid_from_mesh(read(out / "kit.stl")), solid_from_mesh(read(out / "part.stl"))
    assert 2.48 < report["clearance_smallest_mm"] <= report["clearance_largest_mm"] < 2.6
    for share in (0.1, 0.5, 0.9):
        wall, body = kit.slice(-share * report["depth_mm"]), part.slice(-share * report["depth_mm"])
        assert (wall ^ body.offset(2.48)).area() < 1e-6
        assert (wall ^ body.offset(2.6)).area() > 0.05 * body.offset(2.6).area() / 100


def test_the_seated_scene_is_the_same_in_metres(out: Path) -> None:
    bodies = read_glb(out / "seated.glb")
    assert list(bodies) == ["kit", "part"]
    for name, mesh in bodies.items():
        assert np.allclose(mesh.bounds * 1e3, read(out / f"{name}.stl").bounds, atol=EXACT)
    seen = trimesh.load_scene(out / "seated.glb")
    assert np.allclose(seen.extents[1] * 1e3, np.ptp(np.vstack([m.bounds for m in bodies.values()])[:, 2]) * 1e3)


def test_the_report_states_clearance_repairs_and_scale(out: Path, report: dict[str, Any]) -> None:
    assert (report["part"], report["unit"], report["scale"], report["repairs"]) == ("corner.stl", "mm", 1.0, [])
    assert report["kit_faces"] == len(read_triangles(out / "kit.stl").faces)
    assert report["trial"]["passes"] is True
    assert report["trial"]["keyedness_deg"] > 0


@pytest.mark.parametrize(("step", "warned"), [(0.249, False), (0.25, True), (0.5, True)])
def test_coarse_coordinates_are_a_warning(step: float, warned: bool, out: Path, report: dict[str, Any]) -> None:
    assert 0 < report["coordinate_step_mm"] < 1e-5
    text = kit_report_text(report | {"coordinate_step_mm": step}, out)
    assert ("warning    the file gives coordinates in steps of" in text) == warned


def test_an_interrupted_run_leaves_complete_files_and_no_report(
    out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, replace, left = tmp_path / "out", os.replace, 3
    part = write_stl(tmp_path / "corner.stl", l_shape())
    make_kit_from_file(part, folder, KitOptions(2e-3))
    earlier, whole = file_hashes(folder), file_hashes(out)

    def stopping(source: Path, target: Path) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise KeyboardInterrupt
        replace(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", stopping)
        with pytest.raises(KeyboardInterrupt):
            make_kit_from_file(part, folder)
    left_over = {name: digest for name, digest in file_hashes(folder).items() if not name.startswith(".")}
    assert left_over == {
        "kit.stl": whole["kit.stl"],
        "part.stl": earlier["part.stl"],
        "seated.glb": earlier["seated.glb"],
    }
    make_kit_from_file(part, folder)
    assert file_hashes(folder) == whole


def test_a_part_may_be_scaled_to_fit(tmp_path: Path) -> None:
    made = make_kit_from_file(write_stl(tmp_path / "corner.stl", l_shape()), tmp_path / "out", KitOptions(longest=0.06))
    assert sorted(made["size_mm"]) == pytest.approx([36, 45, 60], abs=1e-3)
    assert made["scale"] == pytest.approx(1.5)
    assert sorted(read(tmp_path / "out/part.stl").extents) == pytest.approx([36, 45, 60], abs=1e-3)


THIN = {"blade": (2.3, 181, 21), "needle": (1, 1, 80), "foil": (0.3, 60, 60), "wire": (0.3, 400, 0.3)}  # [mm]


@pytest.mark.parametrize("turn", [(0, 0, 0), (31, 22, 17)])
@pytest.mark.parametrize("name", THIN)
def test_blades_needles_and_foils_get_kits(name: str, turn: tuple[float, float, float], tmp_path: Path) -> None:
    body = Manifold.cube(tuple(side * 1e-3 for side in THIN[name]), True).rotate(turn)
    made = make_kit_from_file(write_stl(tmp_path / "thin.stl", mesh_from_solid(body)), tmp_path / "out", MM)
    kit, part = (read(tmp_path / "out" / file) for file in ("kit.stl", "part.stl"))
    assert defect_float32(kit) is None
    assert defect_float32(part) is None
    assert made["clearance_smallest_mm"] > 2.48
    assert (solid_from_mesh(kit) ^ solid_from_mesh(part)).volume() < 2e-7 * part.extents.max() * part.area


@pytest.mark.parametrize(("sides", "seen"), [((1e-3, 80e-3), False), ((2e-3, 80e-3), True)])
def test_a_relief_shows_a_body_narrower_than_its_cells(sides: tuple[float, float], seen: bool) -> None:
    body = mesh_from_solid(Manifold.cube((*sides, 1e-3), True))
    heights, _ = lower_envelope(body, sides[1] / RELIEF_CELLS)
    assert np.isfinite(heights).any() == seen
    relief, _, weights = polar_relief(body, 0.6e-3)
    assert set(np.unique(relief.round(9))) == {0.0, 0.6e-3}
    area = (relief * weights[:, None]).sum() / relief.shape[1] / 0.6e-3
    assert 0.5 < area / (sides[0] * sides[1]) < 2.1


def stl_of(path: Path, *solids: Manifold) -> Path:
    """An STL in which each body has its own shell."""
    return write_stl(path, mesh_from_solid(Manifold.compose(list(solids))))


CUBE = Manifold.cube((0.03, 0.03, 0.03))
STUD = Manifold.cube((0.012, 0.012, 0.02))
TURN = (31, 22, 17)
TOGETHER = {
    "overlapping": [CUBE, CUBE.translate((0.02, 0.01, 0.005))],
    "touching": [CUBE, CUBE.translate((0.03, 0.0, 0.0))],
    "standing on": [CUBE, STUD.translate((0.005, 0.01, 0.03))],
    "overlapping, turned": [CUBE.rotate(TURN), STUD.translate((0.005, 0.01, 0.029)).rotate(TURN)],
}
APART = [CUBE, CUBE.scale((0.8, 0.8, 0.8)).translate((0.04, 0, 0))]


@pytest.mark.parametrize("name", TOGETHER)
def test_bodies_that_touch_or_overlap_are_united(name: str, tmp_path: Path) -> None:
    whole = Manifold.batch_boolean(TOGETHER[name], OpType.Add)
    path = stl_of(tmp_path / "two.stl", *TOGETHER[name])
    make_kit_from_file(path, tmp_path / "out", KitOptions(unit="mm", bodies="union"))
    part = read(tmp_path / "out/part.stl")
    assert body_count(part) == 1
    assert part.volume == pytest.approx(whole.volume() * 1e9, rel=1e-3)
    assert defect_float32(part) is None


def test_bodies_apart_are_refused_with_the_way_out(tmp_path: Path) -> None:
    path = stl_of(tmp_path / "two.stl", *APART)
    several = r"two\.stl: 2 separate bodies \(66%, 34% of the volume\)"
    with pytest.raises(InputError, match=several + "; choose --bodies union .*largest, or a file of each"):
        make_kit_from_file(path, tmp_path / "out")
    with pytest.raises(InputError, match=several + ", which neither touch.*; choose --bodies largest, or a file"):
        make_kit_from_file(path, tmp_path / "out", KitOptions(bodies="union"))
    assert not (tmp_path / "out").exists()
    made = make_kit_from_file(path, tmp_path / "out", KitOptions(unit="mm", bodies="largest"))
    assert made["size_mm"] == pytest.approx([30, 30, 30], abs=1e-3)
    assert made["repairs"] == ["kept the largest of 2 bodies (66.1% of the volume)"]


@pytest.mark.parametrize(
    ("smallest", "refusal", "reason"),
    [
        (2.479e-3, None, "clearance of 2.479 mm, expected 2.5 mm"),
        (0.0, None, "came out with a clearance of 0.000 mm"),
        (2.5e-3, NOT_SEATED, "the part does not seat at a goal of its kit"),
    ],
)
def test_an_inexact_kit_is_not_written(
    smallest: float, refusal: str | None, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def inexact(*arguments: Any) -> Iterator[Attempt]:
        design = replace(design_kit(*arguments[:3]), measured_clearance=Clearance(smallest, 2.5e-3))
        yield from [Attempt(design, PairCheck(0.1, False), refusal)] * 2

    monkeypatch.setattr(own_part, "attempts", inexact)
    with pytest.raises(InexactKit, match=rf"^.*corner\.stl: .*{reason}"):
        make_kit_from_file(write_stl(tmp_path / "corner.stl", l_shape()), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_face_is_the_first_that_passes_the_trials_else_the_first_with_an_exact_kit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def tried(refusals: list[str | None], usual: Any = own_part.attempts) -> float:
        def with_refusals(*arguments: Any) -> Iterator[Attempt]:
            for attempt, refusal in zip(usual(*arguments), refusals, strict=False):
                yield replace(attempt, refusal=refusal)

        monkeypatch.setattr(own_part, "attempts", with_refusals)
        made = make_kit_from_file(write_stl(tmp_path / "corner.stl", l_shape()), tmp_path / "out")
        return made["face_probability"]

    first, second, third = (face.probability for face in insertion_faces(part_of_mesh("ell", l_shape()))[:3])
    assert tried([None]) == pytest.approx(first)
    assert tried(["tilted", None]) == pytest.approx(second)
    assert tried([NOT_SEATED, "tilted", "tilted"]) == pytest.approx(second)
    assert tried([NOT_SEATED, "tilted", None]) == pytest.approx(third)
    assert tried(["tilted", "tilted", "tilted"]) == pytest.approx(first)


def test_an_own_plate_lies_flat_though_it_is_low(tmp_path: Path) -> None:
    plate = Manifold.cube((0.06, 0.04, 0.004)) - Manifold.cube((0.02, 0.02, 0.01), True)
    made = make_kit_from_file(stl_of(tmp_path / "plate.stl", plate), tmp_path / "out", MM)
    assert made["depth_mm"] == pytest.approx(0.6 * 4, abs=1e-3)


def test_a_clearance_wider_than_the_part_is_refused(tmp_path: Path) -> None:
    path = write_stl(tmp_path / "corner.stl", l_shape().scaled(0.01))
    with pytest.raises(InputError, match=r"0\.4 mm long.*2\.5 mm.*--clear"):
        make_kit_from_file(path, tmp_path / "out", MM)


def test_the_part_itself_is_never_replaced(
    out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(shutil.copytree(out, tmp_path / "out"))
    before = file_hashes(tmp_path)
    for folder in (".", str(tmp_path / "out"), "../out"):
        assert main(["kit", "part.stl", "--out", folder]) == 2
        assert "--out: is the folder of the part, which would be replaced" in capsys.readouterr().err
    assert file_hashes(tmp_path) == before


@pytest.mark.parametrize("name", ["part.stl", "notes.txt", "01/kit.stl"])
@pytest.mark.parametrize("count", [1, 2])
def test_a_file_of_another_origin_stays(
    name: str, count: int, out: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "out"
    (folder / name).parent.mkdir(parents=True)
    (folder / name).write_text('{"mine": 1}')
    before = file_hashes(folder)
    assert main(["kit", *[str(out.parent / "corner.stl")] * count, "--out", str(folder)]) == 2
    said = capsys.readouterr().err
    assert "is not empty and was not written by this command: choose another --out" in said
    assert said.count("\n") == 1
    assert file_hashes(folder) == before


def test_the_folder_of_an_earlier_run_is_written_again(out: Path, tmp_path: Path) -> None:
    folder, part = shutil.copytree(out, tmp_path / "out"), out.parent / "corner.stl"
    (folder / ".DS_Store").write_text("of the system")
    report = make_kit_from_file(part, folder, KitOptions(2e-3))
    assert json.loads((folder / "report.json").read_bytes()) == report
    assert sorted(file_hashes(folder)) == sorted([*FILES, ".DS_Store"])
    make_kit_from_file(part, folder, KitOptions(preview=False))
    assert not (folder / "preview.png").exists()  # that of the earlier run would show another kit


@pytest.mark.slow
def test_real_parts_get_kits(real_parts: Path, tmp_path: Path) -> None:
    for path in mesh_files(real_parts)[::9]:
        made = make_kit_from_file(path, tmp_path / path.stem)
        kit, part = (solid_from_mesh(read(tmp_path / path.stem / name)) for name in ("kit.stl", "part.stl"))
        film = max(EXACT, 2e-7 * max(made["size_mm"]))  # files hold float32: the floor of a large part is rounded too
        assert (kit ^ part).volume() < film * part.surface_area(), path.name
        assert made["clearance_smallest_mm"] > 2.48


@pytest.mark.parametrize("width", [1e-9, 2e-8])
def test_written_meshes_stay_closed_where_rounding_would_open_them(width: float, tmp_path: Path) -> None:
    """A slit at the origin, where float32 is fine, comes to lie where it is coarse."""
    slit = Manifold.cube((width, 0.04, 0.02)).translate((1e-9, 0.03, 0.09))
    cut = Manifold.cube((0.8, 0.1, 0.1)).translate((-1e-3, 0, 0)) - slit
    part = part_of_mesh("cut", mesh_from_solid(cut))
    design = design_kit(part, plate=None)
    seated = part.mesh.moved(design.kit.slot.kit_from_part)
    assert defect_float32(seated) is not None
    data = own_part.kit_files(part, design, "cut.stl")
    (tmp_path / "part.stl").write_bytes(data["part.stl"])
    (tmp_path / "seated.glb").write_bytes(data["seated.glb"])
    back = read(tmp_path / "part.stl")
    assert defect_float32(back) is None
    assert defect_float32(read_glb(tmp_path / "seated.glb")["part"]) is None
    assert back.volume == pytest.approx(cut.volume() * 1e9, rel=1e-5)
    assert np.abs(back.bounds - seated.bounds * 1e3).max() < 0.02


def test_folders_are_named_after_files_and_numbered_where_equal() -> None:
    paths = [Path(name) for name in ("a/arm.stl", "b/arm.stl", "arm-2.obj", "leg.stl")]
    assert folder_names(paths) == ["arm", "arm-2", "arm-2-2", "leg"]


def test_each_file_gets_a_kit_and_a_bad_one_a_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good, large = write_stl(tmp_path / "good.stl", l_shape()), write_stl(tmp_path / "large.stl", l_shape(60))
    (tmp_path / "bad.stl").write_bytes(b"\0" * 100)
    strange = write_stl(tmp_path / "strange.stl", l_shape(50))
    original = own_part.read_mesh
    monkeypatch.setattr(own_part, "read_mesh", lambda path, *rest: 1 / 0 if path == strange else original(path, *rest))
    paths = [good, tmp_path / "bad.stl", large, strange]
    reports = dict(make_kits(paths, tmp_path / "out", KitOptions(preview=False), workers=1))
    assert json.loads((tmp_path / "out/report.json").read_text()) == reports
    assert "bad.stl" in reports["bad"]
    assert isinstance(reports["bad"], str)
    for name in ("good", "large"):
        report = reports[name]
        assert isinstance(report, dict)
        assert report["part"] == f"{name}.stl"
        names = sorted(path.name for path in (tmp_path / "out" / name).iterdir())
        assert names == ["kit.stl", "part.stl", "report.json", "seated.glb"]
    assert "bug" in str(reports["strange"])


def test_the_command_takes_many_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [str(write_stl(tmp_path / f"{name}.stl", l_shape(size))) for name, size in (("one", 40), ("two", 50))]
    (tmp_path / "text.stl").write_text("no mesh")
    line = ["--no-preview", "--workers", "1", "--unit", "mm"]
    assert main(["kit", str(tmp_path / "text.stl"), *paths, "--out", str(tmp_path / "out"), *line]) == 1
    out, err = capsys.readouterr()
    assert out.count("files      ") == 2
    assert "text.stl: not a mesh: text file" in err
