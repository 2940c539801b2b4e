"""What a submission says about its method: the file manifest.toml, checked field by field."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from datetime import date, datetime
from difflib import get_close_matches
from pathlib import Path
from typing import Any, get_type_hints

from kit1000.errors import InputError
from kit1000.files import write_bytes
from kit1000.sim.cameras import CAMERA_SETS
from kit1000.submission.faults import Fault, first_error, printable, quoted
from kit1000.submission.reading import STRAY, file_bytes, text_of, whole
from kit1000.tracks import TRACKS

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

FILE = "manifest.toml"
CURVES = "curves"
CLAIMS = (*TRACKS, CURVES)
PREDICTS = ("pose", "rotation")
LONGEST_NAME = 80  # characters of a method's name, so that it fits into a table
LONGEST_TEXT = 2000
DAY = re.compile(r"\d{4}-\d{2}-\d{2}\Z", re.ASCII)


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """A method and how it came to its answers."""

    method: str
    """Its name, as the tables show it."""
    authors: tuple[str, ...]
    description: str
    """One or two sentences."""
    url: str = ""
    """Of the paper or the code."""
    date: str
    """YYYY-MM-DD"""
    dataset_id: str
    """As dataset.json has it."""
    tracks: tuple[str, ...]
    """What is answered: tracks of the dataset, and `curves`."""
    predicts: str = "pose"
    """pose, or rotation when the positions are no answer."""
    learned: bool
    """Whether anything was fitted to data."""
    uses_true_geometry: bool
    """Whether meshes or poses were read that only the truth has."""
    control: bool = False
    """Whether this is no method but a yardstick, such as the unchanged guess."""
    training_data: str = ""
    """What it was fitted to."""
    hardware: str = ""
    """What the seconds were measured on."""
    camera_set: str = "primary"
    """Which cameras it reads: primary, three or top."""
    reproduce: str = ""
    """The command that makes these predictions."""
    dataset_checksum: str = ""
    """Of the very copy of the dataset that was read, as dataset.json has it."""

    def __post_init__(self) -> None:
        for name in ("authors", "tracks"):
            value = getattr(self, name)
            object.__setattr__(self, name, (value,) if isinstance(value, str) else tuple(value))
        wrong = next((said for name in KINDS if (said := _misfit(name, getattr(self, name)))), None)
        if wrong is not None:
            raise InputError(f"manifest: {wrong.seen}: expected {wrong.wanted}; {wrong.repair}")


KINDS = get_type_hints(Manifest)
REQUIRED = tuple(field.name for field in fields(Manifest) if field.default is MISSING)


def read_manifest(path: str | Path) -> Manifest:
    """Read a manifest. Raises InputError, with the first fault, when there is one."""
    manifest, faults = manifest_of(Path(path), printable(path))
    error = first_error(faults)
    if error is not None:
        raise InputError(f"{error} (`kit1000 check` lists all faults)")
    assert manifest is not None  # or there would be an error
    return manifest


def write_manifest(path: str | Path, manifest: Manifest) -> None:
    """Write a manifest as TOML: whole or not at all."""
    lines = [f"{field.name} = {_toml(getattr(manifest, field.name))}" for field in fields(manifest)]
    write_bytes(Path(path), "\n".join([*lines, ""]).encode())


def manifest_of(path: Path, file: str) -> tuple[Manifest | None, list[Fault]]:
    """A manifest and all that is wrong with it; `file` is what messages call it. No manifest when there are errors."""
    data, faults = file_bytes(path, file)
    text, more = (None, []) if data is None else text_of(data, file)
    faults += more
    if text is None:
        return None, faults
    values, fault = _parsed(text, file)
    if fault is not None:
        return None, [*faults, fault]
    faults += _value_faults(values, text, file)
    if first_error(faults) is not None:
        return None, faults
    return Manifest(**{name: _plain(value) for name, value in values.items()}), faults


def line_of(name: str, text: str) -> int | None:
    """The line of a manifest that sets a field."""
    match = re.search(rf"""^[ \t]*["']?{re.escape(name)}["']?[ \t]*=""", text, re.MULTILINE)
    return text.count("\n", 0, match.start()) + 1 if match else None


def _parsed(text: str, file: str) -> tuple[dict[str, Any], Fault | None]:
    stray = STRAY.search(text)
    if stray:
        line, column = text.count("\n", 0, stray.start()) + 1, stray.start() - text.rfind("\n", 0, stray.start())
        seen = f"byte 0x{ord(stray[0]) & 0xFF:02X}"
        return {}, Fault(file, line, column, seen, "UTF-8 text", "write the file again", "error", "stray-byte")
    try:
        return tomllib.loads(text), None
    except (ValueError, RecursionError) as error:  # numbers or nesting beyond all measure among them
        said = " ".join(str(error).split())
        place = re.search(r" \(at line (\d+), column (\d+)\)", said)
        at = (int(place[1]), int(place[2])) if place else (None, None)
        seen = printable(said[: place.start()] if place else said[:200]) or "not TOML"
        repair = "write name = value, with text in quotes and lists in brackets"
        return {}, Fault(file, *at, f"no TOML: {seen}", "TOML", repair, "error", "no-toml")


def _value_faults(values: Mapping[str, Any], text: str, file: str) -> list[Fault]:
    faults = []
    unknown = [name for name in values if name not in KINDS]
    for name in unknown:
        near = get_close_matches(name, [kind for kind in KINDS if kind not in values], n=1, cutoff=0.6)
        repair = f"did you mean {near[0]}?" if near else "delete it"
        seen = f"{'table' if isinstance(values[name], dict) else 'field'} {quoted(name)}"
        wanted = f"one of {', '.join(KINDS)}"
        faults.append(Fault(file, line_of(name, text), None, seen, wanted, repair, "error", "unknown-field"))
    for name in REQUIRED:
        if name not in values:
            seen, wanted = f"no field {name}", EXPECTED[name]
            faults.append(whole(file, "missing-field", seen, wanted, f"add a line {name} = {EXAMPLES[name]}"))
    for name in KINDS:
        fault = _misfit(name, _plain(values[name]), file, line_of(name, text)) if name in values else None
        faults += [fault] if fault else []
    return faults + (_omissions(values, file) if not faults else [])


def _omissions(values: Mapping[str, Any], file: str) -> list[Fault]:
    """Fields that a reader of the tables would like to know."""
    asked = ["reproduce", "hardware", *(["training_data"] if values["learned"] else [])]
    empty = [name for name in asked if not values.get(name)]
    if not empty or values.get("control"):
        return []
    seen, wanted = f"{' and '.join(empty)} left empty", "what others need to repeat the numbers"
    return [Fault(file, None, None, seen, wanted, "fill in", "warning", "left-empty")]


EXPECTED = {
    "method": f"a name of at most {LONGEST_NAME} characters, in one line",
    "authors": "a list of names",
    "description": f"text of at most {LONGEST_TEXT} characters",
    "url": "an address that begins with https://, or nothing",
    "date": "a day as YYYY-MM-DD",
    "dataset_id": "the dataset_id of dataset.json",
    "tracks": f"a list of some of {', '.join(CLAIMS)}",
    "predicts": " or ".join(PREDICTS),
    "learned": "true or false",
    "uses_true_geometry": "true or false",
    "control": "true or false",
    "camera_set": f"one of {', '.join(CAMERA_SETS)}",
}
EXAMPLES = {
    "method": '"my method"',
    "authors": '["A. Name"]',
    "description": '"What it does."',
    "date": '"2026-01-31"',
    "dataset_id": '"0123456789abcdef"',
    "tracks": '["snap", "place"]',
    "learned": "false",
    "uses_true_geometry": "false",
}


def _misfit(name: str, value: Any, file: str = "", line: int | None = None) -> Fault | None:
    """What is wrong with the value of a field."""
    kind = KINDS[name]
    wanted = EXPECTED.get(name, f"text of at most {LONGEST_TEXT} characters")
    if kind is bool:
        right, repair = isinstance(value, bool), "write true or false, without quotes"
    elif kind is str:
        right, repair = isinstance(value, str), "put it in quotes"
    else:
        listed = isinstance(value, list | tuple) and all(isinstance(item, str) for item in value)
        right, repair = listed, 'write a list of texts, such as ["a", "b"]'
    seen = f"{name} = {quoted(list(value) if isinstance(value, tuple) else value)}"
    if not right:
        return Fault(file, line, None, seen, wanted, repair, "error", "wrong-type")
    said = _wrong_value(name, value)
    return said and Fault(file, line, None, seen, wanted, said[1], "error", said[0])


def _wrong_value(name: str, value: str | bool | Sequence[str]) -> tuple[str, str] | None:
    """Name and repair of a value that has the right type."""
    if isinstance(value, bool):
        return None
    texts = [value] if isinstance(value, str) else list(value)
    short = name in ("method", "dataset_id", "dataset_checksum")
    if any(STRAY.search(text) for text in texts):
        return "stray-byte", "leave out control characters"
    if any(len(text) > (LONGEST_NAME if short else LONGEST_TEXT) for text in texts):
        return "too-long", "shorten it"
    if (short or name == "authors") and any("\n" in text for text in texts):
        return "two-lines", "write it in one line"
    if name in REQUIRED and not (texts and all(text.strip() for text in texts)):
        return "empty-field", "fill in"
    if name in CHOICES:
        return _choice(texts, CHOICES[name])
    if name == "date" and not _is_day(texts[0]):
        return "no-date", "write year, month and day, such as 2026-01-31"
    if name == "url" and texts[0] and not re.match(r"https?://[^\s/]+\S*\Z", texts[0]):
        return "no-url", "write the whole address, with https://"
    return None


CHOICES = {"tracks": CLAIMS, "predicts": PREDICTS, "camera_set": CAMERA_SETS}


def _choice(texts: list[str], known: tuple[str, ...]) -> tuple[str, str] | None:
    odd = [text for text in texts if text not in known]
    if odd:
        near = get_close_matches(odd[0].lower().replace("_", "-"), known, n=1, cutoff=0.5)
        return "no-choice", f"did you mean {near[0]}?" if near else f"delete {quoted(odd[0])}"
    return ("double", "name each once") if len(set(texts)) < len(texts) else None


def _is_day(text: str) -> bool:
    try:
        date.fromisoformat(text)
    except ValueError:
        return False
    return bool(DAY.match(text))


def _plain(value: Any) -> Any:
    """TOML has dates of its own, and lists where we have tuples."""
    if isinstance(value, date) and not isinstance(value, datetime):
        return value.isoformat()
    return tuple(value) if isinstance(value, list) else value


def _toml(value: str | bool | tuple[str, ...]) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    escaped = value.replace("\\", "\\\\").replace('"', '\\"')
    for sign, code in (("\n", "\\n"), ("\t", "\\t"), ("\r", "\\r")):
        escaped = escaped.replace(sign, code)
    return f'"{escaped}"'
