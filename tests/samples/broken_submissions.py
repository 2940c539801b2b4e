"""Submissions with one fault each: the content of the file, and the code and the line of the fault."""

from __future__ import annotations

import gzip

from kit1000.submission import HEADER

ROWS: tuple[str, ...] = (
    "test-s0000-p0-snap,1.0,0.0,0.0,0.0,0.1,-0.25,0.05,0.9,0.5",
    "test-s0001-p2-snap,0.8,0.0,0.0,0.6,0.3,0.2,0.01,0.5,0.25",
    "test-s0002-p1-snap,0.0,0.6,0.8,0.0,-0.1,0.25,0.02,0.25,-1",
    "test-s0003-p0-place,0.0,0.0,0.0,1.0,0.1,0.2,0.03,0,0",
)
HEAD = ",".join(HEADER)
GOOD: str = "\n".join([HEAD, *ROWS, ""])
MANIFEST = """\
method = "A method"
authors = ["A. Name", "B. Name"]
description = "It predicts."
url = "https://example.org/paper"
date = "2026-01-31"
dataset_id = "0123456789abcdef"
tracks = ["snap", "place"]
predicts = "pose"
learned = false
uses_true_geometry = false
control = false
training_data = ""
hardware = "a processor"
camera_set = "primary"
reproduce = "python -m method"
"""


def row(line: int, field: str, value: str) -> str:
    """The valid file with another value in a line, counted from 1 for the header."""
    lines = GOOD.split("\n")
    fields = lines[line - 1].split(",")
    fields[HEADER.index(field)] = value
    lines[line - 1] = ",".join(fields)
    return "\n".join(lines)


def with_line(line: int, text: str) -> str:
    """The valid file with an inserted line."""
    lines = GOOD.split("\n")
    return "\n".join([*lines[: line - 1], text, *lines[line - 1 :]])


def with_header(text: str) -> str:
    return "\n".join([text, *ROWS, ""])


def permuted(order: tuple[int, ...]) -> str:
    rows = [line.split(",") for line in GOOD.split("\n")[:-1]]
    return "\n".join([",".join(fields[i] for i in order) for fields in rows] + [""])


NO_NUMBERS = (
    "", "abc", "nan", "None", "-inf", "1e999", '"0,8"', "1_000.5", "0.8.1", "np.float64(0.5)", "[0.8", "300 mm",
    "01.Jan", "#REF!", "TRUE", "0x1.8p-1", "\u22120.3", "\uff10.\uff13", "x" * 500, "0\x00.0", "4/5",
)  # fmt: skip
BROKEN: dict[str, tuple[str | bytes, str, int | None]] = {
    "nothing": (b"", "empty", None),
    "blanks alone": (b" \n\n\r\n", "empty", None),
    "header alone": (HEAD + "\n", "no-rows", None),
    "no header": ("\n".join(ROWS) + "\n", "header", 1),
    "another text": ("Dear all,\nplease find attached\n", "header", 1),
    "line of a spreadsheet": ("sep=,\n" + GOOD, "header", 1),
    "git lfs": ("version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git-lfs", None),
    "gzip": (gzip.compress(GOOD.encode(), mtime=0), "not-utf-8", 1),
    "utf-16": (GOOD.encode("utf-16"), "not-utf-8", 1),
    "latin-1": (row(3, "query_id", "été").encode("latin-1"), "not-utf-8", 3),
    "header in capitals": (with_header(HEAD.upper()), "header", 1),
    "header with a synonym": (with_header(HEAD.replace("seconds", "time")), "header", 1),
    "xyzw header": (permuted((0, 2, 3, 4, 1, 5, 6, 7, 8, 9)), "header", 1),
    "column missing": (permuted((0, 1, 2, 3, 4, 5, 6, 7, 8)), "header", 1),
    "column added": ("\n".join([HEAD + ",scene", *(r + ",7" for r in ROWS), ""]), "header", 1),
    "semicolons": (GOOD.replace(",", ";"), "header", 1),
    "European sheet": (GOOD.replace(",", ";").replace(".", ","), "header", 1),
    "semicolons in a row": (GOOD.replace(ROWS[1], ROWS[1].replace(",", ";")), "fields", 3),
    "decimal commas": (GOOD.replace(ROWS[1], ROWS[1].replace(".", ",")), "fields", 3),
    "too few fields": (with_line(3, "test-s0009-p0-snap,1,0,0,0"), "fields", 3),
    "too many fields": (with_line(3, ROWS[1].replace("s0001", "s0009") + ",7"), "fields", 3),
    "cut off": (GOOD[:-12], "fields", 5),
    "open quote": (row(3, "query_id", '"test-s0001-p2-snap'), "fields", 3),
    "huge line": (row(3, "qw", "1" * 100_000), "fields", 3),
    "row commented out": (with_line(3, "#" + ROWS[1]), "invalid-id", 3),
    "no id": (row(3, "query_id", ""), "invalid-id", 3),
    "id with a blank": (row(3, "query_id", "test s0001 p2 snap"), "invalid-id", 3),
    "double": (row(4, "query_id", "test-s0000-p0-snap"), "duplicate-id", 4),
    **{f"no number {value[:20]!r}": (row(3, "x", value), "not-a-number", 3) for value in NO_NUMBERS},
    "zero quaternion": (row(2, "qw", "0"), "quaternion-norm", 2),
    "quaternion too long": (row(2, "qw", "1.02"), "quaternion-norm", 2),
    "percent": (row(2, "confidence", "90"), "confidence-range", 2),
    "negative confidence": (row(2, "confidence", "-0.5"), "confidence-range", 2),
    "negative seconds": (row(2, "seconds", "-0.5"), "seconds-range", 2),
    "beyond all tables": (row(2, "x", "-1e12"), "position-range", 2),
}
WARNINGS: dict[str, tuple[str | bytes, str, int | None]] = {
    "no line end": (GOOD[:-1], "no-line-end", 5),
}
READ_WITHOUT_FAULT: dict[str, str | bytes] = {
    "byte order mark": b"\xef\xbb\xbf" + GOOD.encode(),
    "Windows": GOOD.replace("\n", "\r\n"),
    "an old Mac": GOOD.replace("\n", "\r"),
    "empty lines": "\n" + with_line(3, "") + "\n",
    "rows of separators": with_line(3, ",,,,,,,,,"),
    "quoted": "\n".join(",".join(f'"{field}"' for field in line.split(",")) for line in GOOD.splitlines()) + "\n",
    "blanks around numbers": row(3, "qw", " 8e-1 "),
}


def as_bytes(content: str | bytes) -> bytes:
    return content if isinstance(content, bytes) else content.encode()


def field(name: str, value: str | None) -> str:
    """The valid manifest with another value, or none, for a field."""
    lines = MANIFEST.splitlines()
    i = next(i for i, line in enumerate(lines) if line.startswith(f"{name} ="))
    return "\n".join([*lines[:i], *([] if value is None else [f"{name} = {value}"]), *lines[i + 1 :], ""])


SNAP_ONLY = field("tracks", '["snap"]')
INVALID_FIELDS = (
    ("method", "7"), ("learned", '"no"'), ("authors", '"A. Name"'), ("authors", "[1, 2]"), ("tracks", "[]"),
    ("tracks", '["snap", "palce"]'), ("tracks", '["snap", "snap"]'), ("date", '"31.01.2026"'), ("date", '"2026-02-30"'),
    ("date", "2026-01-31T10:00:00"), ("predicts", '"rotations"'), ("camera_set", '"four"'), ("url", '"example.org"'),
    ("method", '" "'), ("method", f'"{"x" * 100}"'), ("method", '"a\\nb"'), ("method", '"a\\u0007"'),
)  # fmt: skip
BROKEN_MANIFESTS: dict[str, tuple[str | bytes, str, int | None]] = {
    "empty": ("", "empty", None),
    "not TOML": ("method: a\n", "not-toml", None),
    "twice": (MANIFEST + 'method = "b"\n', "not-toml", None),
    "deep": ("a = " + "[" * 100_000, "not-toml", None),
    "long number": ("a = " + "1" * 100_000, "not-toml", None),
    "bytes": (MANIFEST.encode() + b"\xff", "not-utf-8", 16),
    "no method": (field("method", None), "missing-field", None),
    "no learned": (field("learned", None), "missing-field", None),
    "table": (MANIFEST + "[extra]\na = 1\n", "unknown-field", None),
    "misspelt": (MANIFEST.replace("authors", "auhtors"), "unknown-field", 2),
    "long label": (MANIFEST + f'label = "{"x" * 100}"\n', "invalid-value", 16),
    "two paper rows": (MANIFEST + 'paper_row = ["a", "b"]\n', "invalid-value", 16),
    **{
        f"{name} = {value[:20]}": (field(name, value), "invalid-value", line_of)
        for name, value in INVALID_FIELDS
        for line_of in [1 + [line.split(" ")[0] for line in MANIFEST.splitlines()].index(name)]
    },
}
MANIFEST_WARNINGS: dict[str, tuple[str | bytes, str, int | None]] = {
    "claimed": (field("tracks", '["snap", "place", "curves"]'), "empty-track", None),
    "not claimed": (SNAP_ONLY, "unlisted-track", None),
    "left empty": (field("hardware", '""'), "left-empty", None),
    "learned from what": (field("learned", "true"), "left-empty", None),
}
