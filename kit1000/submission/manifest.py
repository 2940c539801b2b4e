"""The manifest of a submission, manifest.toml: a description of its method, checked field by field."""

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
from kit1000.queries.tracks import ALL_TRACKS
from kit1000.sim.cameras import CAMERA_SETS
from kit1000.submission.faults import Fault, first_error, printable, quote
from kit1000.submission.reading import UNPRINTABLE, decode_text, file_error, read_file

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

FILE = "manifest.toml"
PREDICTS = ("pose", "rotation")
MASKS = ("given", "predicted")
MAX_NAME = 80  # characters of a name or label, so that it fits into a table
MAX_TEXT = 2000  # characters of any other field
DAY = re.compile(r"\d{4}-\d{2}-\d{2}\Z", re.ASCII)


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """A method and how it made its predictions."""

    method: str
    """Its name, unique among the submissions of a leaderboard."""
    label: str = ""
    """Short name in tables; the method's name when left out."""
    authors: tuple[str, ...]
    description: str
    """One or two sentences."""
    url: str = ""
    """Address of the paper or the code."""
    date: str
    """YYYY-MM-DD"""
    dataset_id: str
    """As dataset.json has it."""
    tracks: tuple[str, ...]
    """The tracks with predictions: those of the dataset, and `curves`."""
    predicts: str = "pose"
    """pose, or rotation when the positions are not predicted."""
    learned: bool
    """Whether anything was fitted to data."""
    uses_true_geometry: bool
    """Whether the method reads meshes or poses of the ground truth."""
    control: bool = False
    """Whether this is a control and no method, such as the unchanged initial guess."""
    paper_row: str = ""
    """Key of the row of the paper's Table I that it reproduces, see `benchmark.table1`; none when left out."""
    training_data: str = ""
    """The data it was fitted to."""
    hardware: str = ""
    """The computer on which the seconds were measured."""
    camera_set: str = "primary"
    """The cameras it reads: primary, three or top."""
    masks: str = "given"
    """The masks it reads: those of the dataset, given, or predicted from depth."""
    reproduce: str = ""
    """The command that makes these predictions."""
    dataset_checksum: str = ""
    """Checksum of the copy of the dataset that was read, as dataset.json has it."""
    source: str = ""
    """Hash of the code and the weights that made the rows, so that those of others are not mixed in."""

    def __post_init__(self) -> None:
        for name in ("authors", "tracks"):
            value = getattr(self, name)
            object.__setattr__(self, name, (value,) if isinstance(value, str) else tuple(value))
        first = next((fault for name in FIELD_TYPES if (fault := _value_fault(name, getattr(self, name)))), None)
        if first is not None:
            raise InputError(f"manifest: {first.actual}: expected {first.expected}; {first.repair}")

    @property
    def display_name(self) -> str:
        """The label, or the method's name where there is none."""
        return self.label or self.method


FIELD_TYPES = get_type_hints(Manifest)
REQUIRED = tuple(field.name for field in fields(Manifest) if field.default is MISSING)


def read_manifest(path: str | Path, inside: Path | None = None) -> Manifest:
    """Read a manifest. Raises InputError, with the first fault, when there is one.

    Args:
        path: of the file.
        inside: the folder that a link must not lead out of; any link is followed when absent.
    """
    manifest, faults = manifest_of(Path(path), printable(path), inside)
    error = first_error(faults)
    if error is not None:
        raise InputError(f"{error} (`kit1000 check` lists all faults)")
    assert manifest is not None  # or there would be an error
    return manifest


def write_manifest(path: str | Path, manifest: Manifest) -> None:
    """Write a manifest as TOML: whole or not at all."""
    lines = [f"{field.name} = {_toml(getattr(manifest, field.name))}" for field in fields(manifest)]
    write_bytes(Path(path), "\n".join([*lines, ""]).encode())


def manifest_of(path: Path, file: str, inside: Path | None = None) -> tuple[Manifest | None, list[Fault]]:
    """A manifest and its faults; `file` is its name in messages. The manifest is None when there are errors."""
    data, faults = read_file(path, file, inside)
    text, more = (None, []) if data is None else decode_text(data, file)
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
    match = UNPRINTABLE.search(text)
    if match:
        line, column = text.count("\n", 0, match.start()) + 1, match.start() - text.rfind("\n", 0, match.start())
        actual = f"byte 0x{ord(match[0]) & 0xFF:02X}"
        return {}, Fault(file, line, column, actual, "UTF-8 text", "write the file again", "error", "invalid-byte")
    try:
        return tomllib.loads(text), None
    except (ValueError, RecursionError) as error:  # numbers or nesting out of range included
        message = " ".join(str(error).split())
        location = re.search(r" \(at line (\d+), column (\d+)\)", message)
        line, column = (int(location[1]), int(location[2])) if location else (None, None)
        reason = printable(message[: location.start()] if location else message[:200]) or "cannot be parsed"
        repair = "write name = value, with text in quotes and lists in brackets"
        return {}, Fault(file, line, column, f"not TOML: {reason}", "TOML", repair, "error", "not-toml")


def _value_faults(values: Mapping[str, Any], text: str, file: str) -> list[Fault]:
    faults = []
    unknown = [name for name in values if name not in FIELD_TYPES]
    for name in unknown:
        similar = get_close_matches(name, [field for field in FIELD_TYPES if field not in values], n=1, cutoff=0.6)
        repair = f"did you mean {similar[0]}?" if similar else "delete it"
        actual = f"{'table' if isinstance(values[name], dict) else 'field'} {quote(name)}"
        expected = f"one of {', '.join(FIELD_TYPES)}"
        faults.append(Fault(file, line_of(name, text), None, actual, expected, repair, "error", "unknown-field"))
    for name in REQUIRED:
        if name not in values:
            actual, expected = f"no field {name}", EXPECTED[name]
            faults.append(file_error(file, "missing-field", actual, expected, f"add a line {name} = {EXAMPLES[name]}"))
    for name in FIELD_TYPES:
        fault = _value_fault(name, _plain(values[name]), file, line_of(name, text)) if name in values else None
        faults += [fault] if fault else []
    return faults + (_omissions(values, file) if not faults else [])


def _omissions(values: Mapping[str, Any], file: str) -> list[Fault]:
    """A warning about empty fields that others need to reproduce the numbers."""
    needed = ["reproduce", "hardware", *(["training_data"] if values["learned"] else [])]
    empty = [name for name in needed if not values.get(name)]
    if not empty or values.get("control"):
        return []
    actual, expected = f"{' and '.join(empty)} left empty", "what others need to reproduce the scores"
    return [Fault(file, None, None, actual, expected, "fill in", "warning", "left-empty")]


EXPECTED = {
    "method": f"a name of at most {MAX_NAME} characters, in one line",
    "label": f"a short name of at most {MAX_NAME} characters, in one line, or nothing",
    "authors": "a list of names",
    "description": f"text of at most {MAX_TEXT} characters",
    "url": "an address that begins with https://, or nothing",
    "date": "a day as YYYY-MM-DD",
    "dataset_id": "the dataset_id of dataset.json",
    "tracks": f"a list of some of {', '.join(ALL_TRACKS)}",
    "predicts": " or ".join(PREDICTS),
    "learned": "true or false",
    "uses_true_geometry": "true or false",
    "control": "true or false",
    "paper_row": f"the key of a row of Table I, of at most {MAX_NAME} characters, in one line, or nothing",
    "camera_set": f"one of {', '.join(CAMERA_SETS)}",
    "masks": " or ".join(MASKS),
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


def _value_fault(name: str, value: Any, file: str = "", line: int | None = None) -> Fault | None:
    """The fault of a field's value; None where it is right."""
    kind = FIELD_TYPES[name]
    expected = EXPECTED.get(name, f"text of at most {MAX_TEXT} characters")
    if kind is bool:
        right, repair = isinstance(value, bool), "write true or false, without quotes"
    elif kind is str:
        right, repair = isinstance(value, str), "put it in quotes"
    else:
        listed = isinstance(value, list | tuple) and all(isinstance(item, str) for item in value)
        right, repair = listed, 'write a list of texts, such as ["a", "b"]'
    actual = f"{name} = {quote(list(value) if isinstance(value, tuple) else value)}"
    if not right:
        return Fault(file, line, None, actual, expected, repair, "error", "wrong-type")
    wrong = _wrong_value(name, value)
    return wrong and Fault(file, line, None, actual, expected, wrong[1], "error", wrong[0])


def _wrong_value(name: str, value: str | bool | Sequence[str]) -> tuple[str, str] | None:
    """Code and repair of a wrong value of the right type; None for a valid value."""
    if isinstance(value, bool):
        return None
    texts = [value] if isinstance(value, str) else list(value)
    short = name in ("method", "label", "paper_row", "dataset_id", "dataset_checksum", "source")
    if any(UNPRINTABLE.search(text) for text in texts):
        return "control-character", "delete control characters"
    if any(len(text) > (MAX_NAME if short else MAX_TEXT) for text in texts):
        return "too-long", "shorten it"
    if (short or name == "authors") and any("\n" in text for text in texts):
        return "two-lines", "write it in one line"
    if name in REQUIRED and not (texts and all(text.strip() for text in texts)):
        return "empty-field", "fill in"
    if name in CHOICES:
        return _choice(texts, CHOICES[name])
    if name == "date" and not _is_day(texts[0]):
        return "invalid-date", "write year, month and day, such as 2026-01-31"
    if name == "url" and texts[0] and not re.match(r"https?://[^\s/]+\S*\Z", texts[0]):
        return "invalid-url", "write the whole address, with https://"
    return None


CHOICES = {"tracks": ALL_TRACKS, "predicts": PREDICTS, "camera_set": CAMERA_SETS, "masks": MASKS}


def _choice(texts: list[str], known: tuple[str, ...]) -> tuple[str, str] | None:
    unknown = [text for text in texts if text not in known]
    if unknown:
        similar = get_close_matches(unknown[0].lower().replace("_", "-"), known, n=1, cutoff=0.5)
        return "unknown-value", f"did you mean {similar[0]}?" if similar else f"delete {quote(unknown[0])}"
    return ("duplicate-value", "list each once") if len(set(texts)) < len(texts) else None


def _is_day(text: str) -> bool:
    try:
        date.fromisoformat(text)
    except ValueError:
        return False
    return bool(DAY.match(text))


def _plain(value: Any) -> Any:
    """A TOML value as the manifest has it: dates as text, lists as tuples."""
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
