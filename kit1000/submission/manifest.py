"""The manifest of a submission, manifest.toml: a description of its method, checked field by field."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields
from datetime import date, datetime
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import msgspec
from msgspec import Meta

from kit1000.errors import InputError, did_you_mean
from kit1000.files import write_bytes
from kit1000.queries.tracks import ALL_TRACKS
from kit1000.sim.cameras import CAMERA_SETS
from kit1000.submission.faults import Fault, file_error, file_warning, printable, quote
from kit1000.submission.reading import read_text

FILE = "manifest.toml"
EXAMPLE_ID = "0123456789abcdef"  # of a dataset, in messages
MAX_NAME, MAX_TEXT = 80, 2000  # characters: a name fits into a table
CONTROLS = r"\x00-\x08\x0b-\x1f\x7f\ud800-\udfff"  # control characters, and what UTF-8 cannot encode
LINE = rf"[^\n{CONTROLS}]*\Z"
DAY = r"\A\d{4}-\d\d-\d\d\Z"
FILLED = r"\A(?=[\s\S]*\S)"


def _text(expected: str, pattern: str, most: int = MAX_TEXT, **options: Any) -> Meta:
    return Meta(max_length=most, pattern=pattern, description=f"{expected} of at most {most} characters", **options)


def _one_of(choices: Sequence[str], **options: Any) -> Meta:
    return Meta(pattern=rf"\A({'|'.join(choices)})\Z", description=f"one of {', '.join(choices)}", **options)


Name = Annotated[str, _text("one line of text", FILLED + LINE, MAX_NAME, examples=["my method"])]
ShortLine = Annotated[str, _text("one line of text", r"\A" + LINE, MAX_NAME)]
Text = Annotated[str, _text("text", rf"\A[^{CONTROLS}]*\Z")]
Flag = Annotated[bool, Meta(description="true or false, without quotes", examples=[False])]
Author = Annotated[str, _text("one line of text", FILLED + LINE)]


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """A method and how it made its predictions."""

    method: Name
    """Its name, unique among the submissions of a leaderboard."""
    label: ShortLine = ""
    """Short name in tables; the method's name if left out."""
    authors: Annotated[tuple[Author, ...], Meta(min_length=1, description="a list of names", examples=[["A. Name"]])]
    description: Annotated[str, _text("text", rf"{FILLED}[^{CONTROLS}]*\Z", examples=["What it does."])]
    """One or two sentences."""
    url: Annotated[str, _text("an address that begins with https://", r"\A(https?://[^\s/]+\S*)?\Z")] = ""
    """Address of the paper or the code."""
    date: Annotated[str, Meta(pattern=DAY, description="a day as YYYY-MM-DD", examples=["2026-01-31"])]
    """YYYY-MM-DD"""
    dataset_id: Annotated[str, _text("the dataset_id of dataset.json", FILLED + LINE, MAX_NAME, examples=[EXAMPLE_ID])]
    """As dataset.json has it."""
    tracks: Annotated[
        tuple[Annotated[str, _one_of(ALL_TRACKS)], ...],
        Meta(min_length=1, description=f"a list of some of {', '.join(ALL_TRACKS)}", examples=[["snap", "place"]]),
    ]
    """The tracks with predictions: those of the dataset, and `curves`."""
    predicts: Annotated[str, _one_of(("pose", "rotation"))] = "pose"
    """pose, or rotation if the positions are not predicted."""
    learned: Flag
    """Whether anything was fitted to data."""
    uses_true_geometry: Flag
    """Whether the method reads meshes or poses of the ground truth."""
    reads: Annotated[str, _one_of(("image", "shapes"))] = "image"
    """What it reads of the scene: the image, or the meshes of its parts and kits too, without poses."""
    control: Flag = False
    """Whether this is a control and no method, such as the unchanged initial guess."""
    paper_row: ShortLine = ""
    """Key of the row of the paper's Table I that it reproduces, see `benchmark.table1`; none if left out."""
    training_data: Text = ""
    """The data it was fitted to."""
    hardware: Text = ""
    """The computer on which the seconds were measured."""
    camera_set: Annotated[str, _one_of(CAMERA_SETS)] = "primary"
    """The cameras it reads: primary, three or top."""
    masks: Annotated[str, _one_of(("given", "predicted"))] = "given"
    """The masks it reads: those of the dataset, given, or predicted from depth."""
    reproduce: Text = ""
    """The command that makes these predictions."""
    dataset_checksum: ShortLine = ""
    """Checksum of the copy of the dataset that was read, as dataset.json has it."""
    source: ShortLine = ""
    """Hash of the code and the weights that made the rows, so that rows of others are not mixed in."""

    def __post_init__(self) -> None:
        for name in ("authors", "tracks"):
            value = getattr(self, name)
            object.__setattr__(self, name, (value,) if isinstance(value, str) else tuple(value))
        for name in FIELD_TYPES:
            fault = _value_fault(name, getattr(self, name), "")
            if fault is not None:
                raise InputError(f"manifest: {fault.actual}: expected {fault.expected}")

    @property
    def display_name(self) -> str:
        """The label, or the method's name if there is none."""
        return self.label or self.method


FIELD_TYPES = get_type_hints(Manifest, include_extras=True)
META: dict[str, Meta] = {name: kind.__metadata__[0] for name, kind in FIELD_TYPES.items()}
REQUIRED = tuple(field.name for field in fields(Manifest) if field.default is MISSING)


def read_manifest(path: str | Path, inside: Path | None = None) -> Manifest:
    """Read a manifest. Raises InputError with its first error, if it has any.

    Args:
        path: of the file.
        inside: the folder that a link must not lead out of; any link is followed if absent.
    """
    manifest, faults = parse_manifest(read_text(Path(path), printable(path), inside), printable(path))
    if manifest is None:
        raise InputError(f"{faults[0]} (`kit1000 check` lists all faults)")
    return manifest


def write_manifest(path: str | Path, manifest: Manifest) -> None:
    """Write a manifest as TOML: completely or not at all."""
    values = {field.name: getattr(manifest, field.name) for field in fields(manifest)}
    lines = [f"{name} = {_toml(value)}" for name, value in values.items()]
    write_bytes(Path(path), "\n".join([*lines, ""]).encode())


def _toml(value: object) -> str:
    """A text, a truth value or texts as TOML, which writes them as JSON does."""
    return json.dumps(value, ensure_ascii=False)


def parse_manifest(text: str | Fault, file: str) -> tuple[Manifest | None, list[Fault]]:
    """A manifest and its faults; it is None if there are errors.

    Args:
        text: of the file, or why it cannot be read.
        file: its name in messages.
    """
    if isinstance(text, Fault):
        return None, [text]
    try:
        values = msgspec.toml.decode(text)
    except (ValueError, RecursionError) as error:  # numbers or nesting out of range included
        reason = printable(" ".join(str(error).split())[:200]) or "cannot be parsed"
        repair = "write name = value, with text in quotes and lists in brackets"
        return None, [file_error(file, "not-toml", f"not TOML: {reason}", "TOML", repair)]
    values = {name: _plain(value) for name, value in values.items()}
    errors = [fault for name in values if (fault := _field_fault(name, values, file, line_of(name, text)))]
    for name in REQUIRED:
        if name not in values:
            repair = f"add a line {name} = {_toml((META[name].examples or [''])[0])}"
            actual, expected = f"no field {name}", META[name].description or ""
            errors.append(file_error(file, "missing-field", actual, expected, repair))
    if errors:
        return None, errors
    return Manifest(**values), _omissions(values, file)


def line_of(name: str, text: str) -> int | None:
    """The line of a manifest that sets a field."""
    match = re.search(rf"""^[ \t]*["']?{re.escape(name)}["']?[ \t]*=""", text, re.MULTILINE)
    return text.count("\n", 0, match.start()) + 1 if match else None


def _plain(value: Any) -> Any:
    """A TOML value as the manifest has it: a day as text."""
    return value.isoformat() if isinstance(value, date) and not isinstance(value, datetime) else value


def _field_fault(name: str, values: dict[str, Any], file: str, line: int | None) -> Fault | None:
    if name in FIELD_TYPES:
        return _value_fault(name, values[name], file, line)
    repair = did_you_mean(name, [field for field in FIELD_TYPES if field not in values]) or "delete it"
    actual, expected = f"field {quote(name)}", f"one of {', '.join(FIELD_TYPES)}"
    return Fault(file, line, "unknown-field", actual, expected, repair.strip())


def _value_fault(name: str, value: Any, file: str, line: int | None = None) -> Fault | None:
    """The error of a field's value; None if it is valid."""
    try:
        msgspec.convert(value, FIELD_TYPES[name])
        if name == "date":
            date.fromisoformat(value)
        if not isinstance(value, str | bool) and len(set(value)) < len(value):
            raise ValueError
    except ValueError:
        shown = list(value) if isinstance(value, tuple) else value
        expected = META[name].description or ""
        return Fault(file, line, "invalid-value", f"{name} = {quote(shown)}", expected, f"correct {name}")
    return None


def _omissions(values: dict[str, Any], file: str) -> list[Fault]:
    """A warning about empty fields that others need to reproduce the scores."""
    needed = ["reproduce", "hardware", *(["training_data"] if values["learned"] else [])]
    empty = [name for name in needed if not values.get(name)]
    if not empty or values.get("control"):
        return []
    actual, expected = f"{' and '.join(empty)} left empty", "what others need to reproduce the scores"
    return [file_warning(file, "left-empty", actual, expected, "fill in")]
