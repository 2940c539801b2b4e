"""The commands that label scenes with ground truth of your own, and join their folders."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from kit1000.cli.options import Folder, OptionalFloat, OptionalId, OptionalInt, OptionalPath
from kit1000.errors import InputError

if TYPE_CHECKING:
    from kit1000.known_shapes.known_kits import KnownKits
    from kit1000.labelling.labelling_session import OwnScenes


@dataclass(frozen=True)
class Label:
    """Label own scenes with ground truth: register known shapes, check the pictures, confirm."""

    data: Folder
    """Folder of own scenes, as `kit1000 import` writes it."""
    scene: OptionalId = None
    """Id of one scene. Default: all scenes."""
    shapes: OptionalPath = None
    """Dataset folder with the kits in the image, such as one of the preset `print`."""
    assembly: OptionalId = None
    """Id of the assembly in --shapes. Default: the only one."""
    parts: tuple[str, ...] = ()
    """Ids of the parts on the table. Default: all parts of the assembly."""
    kit: OptionalPath = None
    """Mesh file of a kit of your own, instead of --shapes: kit.stl of `kit1000 kit`."""
    part: OptionalPath = None
    """Mesh file of its part, seated in the frame of the kit: part.stl of `kit1000 kit`."""
    clearance_mm: OptionalFloat = None
    """Clearance between part and kit. Default: that of report.json beside --kit."""
    confirm: tuple[str, ...] = ()
    """Bodies that you confirm after you looked at the picture: all, sure, or names such as kits."""
    by: str = ""
    """Your name, which is stored with the labels that you confirm."""
    page: bool = False
    """Open a page on which you move the shapes of a scene, confirm them, and see the residual; Ctrl-C ends it."""
    port: OptionalInt = None
    """Port of the page. Default: a free one."""

    def run(self) -> int:
        """Register or confirm, and print what was found; returns 1 when some bodies remain uncertain."""
        from kit1000.labelling.labelling_session import OwnScenes

        scenes = OwnScenes.of(self.data, self.scene)
        if self.confirm:
            return self._confirm(scenes)
        if self.shapes is None and self.kit is None and self.page:
            return self._serve(scenes.scene_ids[0])
        status = self._register(scenes)
        return self._serve(scenes.scene_ids[0]) if self.page else status

    def _serve(self, scene_id: str) -> int:
        try:
            from kit1000.editor.label_page import run_label_page
        except ModuleNotFoundError as error:
            if error.name != "viser":
                raise
            raise InputError("label --page: needs viser: pip install 'kit1000[edit]'") from None
        run_label_page(self.data, scene_id, self.port)
        return 0

    def _register(self, scenes: OwnScenes) -> int:
        from kit1000.labelling.labelling_session import picture_path, register, report_lines

        sure = True
        for record in register(scenes, self._kits(), self.parts):
            print(*report_lines(record), sep="\n")
            print(f"  {picture_path(self.data, record.scene_id)}")
            sure &= all(body.sure for body in record.bodies)
        print(f"look at the pictures, then: kit1000 label {self.data} --confirm all --by NAME")
        return 0 if sure else 1

    def _confirm(self, scenes: OwnScenes) -> int:
        from kit1000.labelling.labelling_session import confirm, publish, report_lines

        given = [name for name in ("shapes", "kit", "part") if getattr(self, name) is not None]
        if given:
            raise InputError(f"--{given[0]}: not allowed with --confirm, whose labels state their shapes")
        records = confirm(scenes, self.confirm, self.by)
        without = publish(scenes, records)
        for record in records:
            print(*report_lines(record), sep="\n")
        print(f"without truth: {', '.join(without) or 'none'}")
        return 1 if without else 0

    def _kits(self) -> KnownKits:
        return known_kits(self.shapes, self.assembly, self.kit, self.part, self.clearance_mm)


def known_kits(
    shapes: Path | None, assembly: str | None, kit: Path | None, part: Path | None, clearance_mm: float | None
) -> KnownKits:
    """The shapes of the options --shapes and --assembly, or --kit, --part and --clearance-mm."""
    from kit1000.known_shapes.known_kits import kits_of_files, kits_of_folder

    if (shapes is None) == (kit is None):
        raise InputError("expected either --shapes FOLDER, or --kit FILE and --part FILE")
    if shapes is not None:
        if part is not None:
            raise InputError("--part: is for --kit; --shapes has the parts")
        return kits_of_folder(shapes, assembly)
    if kit is None or part is None:
        raise InputError("--kit: needs --part FILE, the part seated in its frame")
    if clearance_mm is not None and not 0.05 <= clearance_mm <= 100:
        raise InputError(f"--clearance-mm: expected 0.05 to 100, got {clearance_mm:g}")
    return kits_of_files(kit, part, None if clearance_mm is None else clearance_mm * 1e-3)


@dataclass(frozen=True)
class Join:
    """Join folders of labelled scenes into one, as the real split; scenes get new ids, licences and names stay."""

    folders: Annotated[Positional[tuple[Path, ...]], arg(metavar="DIR [DIR ...]")]
    """Folders whose labels are confirmed; an earlier joined folder comes first, so that its ids stay."""
    out: Path = Path("real")
    """Folder to write, which must not exist."""

    def run(self) -> int:
        """Join, and print what came from where."""
        from kit1000.labelling.joined_folders import join_folders

        print(*join_folders(self.folders, self.out), f"{self.out}: joined", sep="\n")
        return 0
