"""python examples/kit_for_stl.py part.stl --out my-kit

Makes a kit for your own part at true size: kit.stl and part.stl for a slicer, seated.glb, preview.png and report.json.
Takes 2 s. The command `kit1000 kit part.stl --out my-kit --clearance-mm 0.5` does the same.
"""

from __future__ import annotations

from pathlib import Path

import tyro

from kit1000 import KitOptions, make_kit_from_file


def main(part: tyro.conf.Positional[Path], out: Path = Path("my-kit"), clearance_mm: float = 0.5) -> None:
    """Make the kit of a mesh file.

    Args:
        part: STL, OBJ, PLY, 3MF or GLB.
        out: the folder to write.
        clearance_mm: horizontal gap between the part and the walls of its cavity.
    """
    report = make_kit_from_file(part, out, KitOptions(clearance_mm * 1e-3))
    print(f"{part.name}, read in {report['unit']}: {' x '.join(f'{side:g}' for side in report['size_mm'])} mm")
    print(f"cavity {report['depth_mm']:.1f} mm deep, {report['goals']} poses seat the part")
    print(f"seating trials {'passed' if report['trial']['passes'] else 'failed: ' + report['trial']['why']}")
    print(*sorted(path.name for path in out.iterdir()))


if __name__ == "__main__":
    tyro.cli(main)
