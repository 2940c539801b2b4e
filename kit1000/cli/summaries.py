"""The contents of a dataset.json and the report of a kit as text for the command line."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from kit1000.dataset.own_scenes import JOINED, OWN, groups_of_places, is_labelled, is_own
from kit1000.errors import shown

MAX_LISTED = 20  # refused files in a summary
PRINTER_BED_MM = 250  # side of the bed of a usual desktop printer
COARSE_STEP = 0.1  # of the clearance: coordinates in larger steps get a warning


def summary_text(summary: dict) -> str:
    """The contents of a dataset.json as text."""
    if is_own(summary) or "preset" not in summary:
        return "\n".join(_own_lines(summary))
    seed = "withheld" if summary["seed"] is None else summary["seed"]
    lines = [
        f"{summary['preset']}  {summary['dataset_id']}"
        f"  (seed {seed}, data {summary['data_version']}, {summary['licence']})"
    ]
    for split in ("train", "val", "test"):
        n = summary["counts"][split]
        lines.append(
            f"  {split:6s} {n['parts']:5d} parts and kits, {n['assemblies']:5d} assemblies, {n['scenes']:5d} scenes"
        )
    for kind, reasons in sorted(summary["redraws"].items()):
        ranked = sorted(reasons.items(), key=lambda item: (-item[1], item[0]))
        lines.append(f"  redraws of {kind}: {', '.join(f'{n}x {reason}' for reason, n in ranked) or 'none'}")
    refused = sorted((summary["refused"] | summary["refused_scenes"]).items())
    refused = [f"  refused {shown(name)}: {shown(reason)}" for name, reason in refused]
    lines += refused[:MAX_LISTED]
    if len(refused) > MAX_LISTED:
        lines.append(f"  {len(refused) - MAX_LISTED} more refused: dataset.json lists them")
    return "\n".join([*lines, *_files_taken(summary)])


def _own_lines(summary: dict) -> Iterator[str]:
    """The lines about a folder of the user's own images, of which an old or foreign one states less."""
    shards, clearance = summary["shards"], summary.get("config", {}).get("clearance")
    scenes = [scene_id for ids in shards.values() for scene_id in ids]
    truth = "labels" if is_labelled(summary) else "no labels"
    stated = "not stated" if clearance is None else f"{1e3 * clearance:g} mm"
    licence = shown(summary.get("licence", "licence not stated"))
    yield f"own scenes  {summary['dataset_id']}  ({len(scenes)} scenes, {truth}, clearance {stated}, {licence})"
    for facts in _sensors(summary):
        step = f"steps of {1e3 * facts['unit']:g} mm" if facts["unit"] else "floats"
        focal = facts["focal_length"]
        recorded = "" if focal is None else f", recorded with fx {focal:.1f} px"
        yield (
            f"  {shown(facts['device'])}: {facts['stream']} stream, {step}, baseline {1e3 * facts['baseline']:g} mm, "
            f"noise {facts['noise_px']:.2f} px{recorded}"
        )
    for scene_id, origin in summary.get(OWN, {}).get(JOINED, {}).items():
        people = ", ".join(map(shown, origin["confirmed_by"]))
        yield f"  {scene_id}  {shown(origin['licence'])}, confirmed by {people}"
    yield from (
        f"  {i}  {shown(source)}" for i, source in zip(scenes, summary.get(OWN, {}).get("sources", ()), strict=False)
    )
    yield from (f"  images of one scene: {shown(', '.join(group))}" for group in groups_of_places(summary))


def _sensors(summary: dict) -> list[dict]:
    """The facts about all sensors of own scenes, each once."""
    from kit1000.perception.sensor_facts import KEY, SCENE_KEY

    stated = [summary.get(KEY, {}), *summary.get(SCENE_KEY, {}).values()]
    return list({str(facts): facts for rows in stated for facts in rows.values()}.values())


def _files_taken(summary: dict) -> list[str]:
    """The last line of a summary: of how many mesh files parts were made, and why not of the others."""
    untried = summary.get("untried_files", 0)
    if not summary["refused"] and not untried:
        return []
    from kit1000.parts.files.read import refusal_counts

    taken = sum(count["parts"] for count in summary["counts"].values())
    tried = taken + len(summary["refused"])
    others = f"; the others: {shown(refusal_counts(summary['refused'].values()))}" if summary["refused"] else ""
    rest = f"; {untried} more not tried: all parts are made" if untried else ""
    return [f"  {taken} of {tried} mesh files taken as parts{others}{rest}"]


def kit_report_text(report: dict, out: Path) -> str:
    """The report of a kit as text."""
    size, plate = (" x ".join(f"{side:.1f}" for side in report[key]) for key in ("size_mm", "plate_mm"))
    lines = [
        f"part       {shown(report['part'])}: {size} mm ({report['unit_reason']})",
        *(f"           {note}" for note in report["repairs"]),
        f"plate      {plate} mm, cavity {report['depth_mm']:.1f} mm deep, part protrudes {report['proud_mm']:.1f} mm",
        f"clearance  {report['clearance_smallest_mm']:.3f} to {report['clearance_largest_mm']:.3f} mm"
        f" (requested {report['clearance_asked_mm']:g})",
        f"walls      {report['walls_removed']} too thin to print, removed ({report['walls_removed_mm3']:.0f} mm3);"
        f" undercuts {report['undercut_lost_mm3']:.0f} mm3",
    ]
    if report["coordinate_step_mm"] >= COARSE_STEP * report["clearance_asked_mm"]:
        step = f"{report['coordinate_step_mm']:.2g} mm"
        lines.append(f"warning    the file gives coordinates in steps of {step}: its shape is exact to that only")
    if not report["trial"]["passes"]:
        lines.append(f"note       the cavity alone does not determine the pose: the part {report['trial']['why']}")
    if max(report["plate_mm"][:2]) > PRINTER_BED_MM:
        lines.append(f"note       the plate is larger than the bed of a usual printer, {PRINTER_BED_MM} mm")
    return "\n".join([*lines, f"files      {shown(out)}"])
