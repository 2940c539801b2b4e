"""Submissions with one fault each: the content of the file, and the expected report."""

from __future__ import annotations

import gzip

import numpy as np

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


def european(separator: str) -> str:
    return GOOD.replace(",", separator).replace(".", ",")


def permuted(order: tuple[int, ...]) -> str:
    rows = [line.split(",") for line in GOOD.split("\n")[:-1]]
    return "\n".join([",".join(fields[i] for i in order) for fields in rows] + [""])


QW_COLUMN = ROWS[1].index(",") + 2  # position in the third line where qw begins

# By description: the content; then code, line and column of the fault, and a part of its message.
BROKEN: dict[str, tuple[str | bytes, str, int | None, int | None, str]] = {
    "nothing": (b"", "empty", None, None, "is empty"),
    "blanks alone": (b" \n\n\r\n", "empty", None, None, "is empty"),
    "header alone": (HEAD + "\n", "no-rows", None, None, "has no readable row"),
    "no header": ("\n".join(ROWS) + "\n", "missing-header", 1, 1, "no header; the first line is"),
    "another text": ("Dear all,\nplease find attached\n", "missing-header", 1, 1, 'the first line is "Dear all,"'),
    "json": ('{"predictions": []}\n', "missing-header", 1, 1, "as in a JSON file"),
    "a web page": ("<!DOCTYPE html>\n<html>", "missing-header", 1, 1, "as in a web page"),
    "git lfs": ("version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "binary", None, None, "git lfs pull"),
    "gzip": (gzip.compress(GOOD.encode(), mtime=0), "binary", None, None, "is a gzip file"),
    "spreadsheet": (b"PK\x03\x04" + bytes(100), "binary", None, None, "save the spreadsheet as CSV"),
    "numpy": (b"\x93NUMPY\x01\x00", "binary", None, None, "a numpy file"),
    "random bytes": (np.random.default_rng(0).bytes(3000), "binary", None, None, "contains binary data"),
    "utf-16": (GOOD.encode("utf-16"), "not-utf-8", None, None, "is UTF-16 text"),
    "utf-16 without mark": (GOOD.encode("utf-16-be"), "not-utf-8", None, None, "iconv -f UTF-16-BE -t UTF-8"),
    "utf-32": (GOOD.encode("utf-32"), "not-utf-8", None, None, "is UTF-32 text"),
    "NUL bytes": (row(3, "qx", "0\x00.0"), "invalid-byte", 3, QW_COLUMN + 5, "byte 0x00"),
    "latin-1": (row(3, "query_id", "été").encode("latin-1"), "invalid-byte", 3, 1, "byte 0xE9, which is not UTF-8"),
    "header in capitals": (with_header(HEAD.upper()), "column-name", 1, 1, 'column "QUERY_ID": expected "query_id"'),
    "header with a blank": (with_header(HEAD.replace(",qw", ", qw")), "column-name", 1, 10, 'column " qw"'),
    "header misspelt": (with_header(HEAD.replace("confidence", "confidance")), "column-name", 1, 28, "confidence"),
    "header with synonyms": (with_header(HEAD.replace("seconds", "time")), "column-name", 1, 39, 'column "time"'),
    "xyzw header": (permuted((0, 2, 3, 4, 1, 5, 6, 7, 8, 9)), "column-order", 1, 1, "query_id,qx,qy,qz,qw,x,y"),
    "column missing": (permuted((0, 1, 2, 3, 4, 5, 6, 7, 8)), "missing-column", 1, 1, "no column seconds"),
    "column added": (
        "\n".join([HEAD + ",scene", *(r + ",7" for r in ROWS), ""]), "unknown-column", 1, 47, 'column "scene"',
    ),
    "column twice": (
        "\n".join([HEAD + ",qw", *(r + ",1" for r in ROWS), ""]), "duplicate-column", 1, 47, 'a second column "qw"',
    ),
    "empty columns": (GOOD.replace("\n", ",,\n"), "empty-column", 1, 47, "column 11 has no name"),
    "empty columns in rows": (
        with_header(HEAD).replace(ROWS[0], ROWS[0] + ",,,"), "empty-columns", 2, len(ROWS[0]) + 2, "13 fields",
    ),
    "semicolons": (GOOD.replace(",", ";"), "separator", 1, None, "separated by semicolons"),
    "tabs": (GOOD.replace(",", "\t"), "separator", 1, None, "separated by tabs"),
    "spaces": (GOOD.replace(",", "  "), "separator", 1, None, "separated by spaces"),
    "bars": (GOOD.replace(",", " | "), "separator", 1, None, "separated by bars"),
    "semicolons in a row": (
        GOOD.replace(ROWS[1], ROWS[1].replace(",", ";")), "separator", 3, 1, "separated by semicolons",
    ),
    "European sheet": (european(";"), "decimal-comma", None, None, "a decimal comma"),
    "decimal comma, separated by commas": (
        GOOD.replace(ROWS[1], ROWS[1].replace(".", ",")), "decimal-comma", 3, QW_COLUMN, "write a decimal point",
    ),
    "decimal comma in quotes": (row(3, "qw", '"0,8"'), "decimal-comma", 3, QW_COLUMN, 'qw = "0,8": expected a number'),
    "thousands": (
        row(3, "seconds", "1_000.5"), "digit-separator", 3, ROWS[1].rindex(",") + 2, "digits without separators",
    ),
    "two points": (row(3, "qw", "0.8.1"), "two-decimal-points", 3, QW_COLUMN, 'qw = "0.8.1"'),
    "text": (row(3, "qw", "abc"), "text", 3, QW_COLUMN, 'qw = "abc": expected a number; write digits'),
    "empty field": (row(3, "qw", ""), "empty-field", 3, QW_COLUMN, 'qw = ""'),
    "empty seconds": (row(5, "seconds", ""), "empty-field", 5, 52, "seconds are -1 when not measured"),
    "NaN": (row(3, "qx", "nan"), "nan", 3, QW_COLUMN + 4, 'qx = "nan": expected a number; omit the row'),
    "N/A": (row(3, "z", "N/A"), "nan", 3, 44, "omit the row when there is no prediction"),
    "None": (row(3, "z", "None"), "nan", 3, 44, "omit the row"),
    "infinity": (row(3, "x", "-inf"), "infinity", 3, 36, 'x = "-inf"'),
    "overflow": (row(3, "x", "1e999"), "overflow", 3, 36, "beyond float64"),
    "numpy's repr": (row(3, "x", "np.float64(0.5)"), "type-repr", 3, 36, "repr(float(value))"),
    "brackets": (row(3, "qw", "[0.8"), "brackets", 3, QW_COLUMN, "only the number"),
    "unit": (row(3, "x", "300 mm"), "unit", 3, 36, "in metres"),
    "date": (row(3, "confidence", "01.Jan"), "date", 3, 49, "format the column"),
    "sheet's error": (row(3, "qw", "#REF!"), "spreadsheet-error", 3, QW_COLUMN, "repair the formula"),
    "fraction": (row(3, "qw", "4/5"), "fraction", 3, QW_COLUMN, "decimal point"),
    "true": (row(3, "confidence", "TRUE"), "boolean", 3, 49, 'confidence = "TRUE"'),
    "hexadecimal": (row(3, "qw", "0x1.8p-1"), "hexadecimal", 3, QW_COLUMN, "decimal point"),
    "complex": (row(3, "qw", "0.8+0j"), "complex", 3, QW_COLUMN, 'qw = "0.8+0j"'),
    "a minus from a text": (row(3, "x", "\u22120.3"), "non-ascii-digits", 3, 36, "the minus sign -"),
    "other digits": (row(3, "x", "\uff10.\uff13"), "non-ascii-digits", 3, 36, "ASCII digits"),
    "huge field": (row(3, "qw", "0." + "1" * 500), "quaternion-norm", 3, QW_COLUMN, "got 0.6"),
    "huge text": (row(3, "qw", "x" * 500), "long-field", 3, QW_COLUMN, "17 digits"),
    "huge line": (row(3, "qw", "1" * 100_000), "long-line", 3, 1, "a line of 1000"),
    "open quote": (row(3, "query_id", '"test-s0001-p2-snap'), "open-quote", 3, 1, "not closed"),
    "too few fields": (with_line(3, "test-s0009-p0-snap,1,0,0,0"), "too-few-fields", 3, 27, "5 fields in"),
    "too many fields": (
        with_line(3, ROWS[1].replace("s0001", "s0009") + ",7"), "too-many-fields", 3, len(ROWS[1]) + 2, "11 fields",
    ),
    "cut off": (GOOD[:-12], "truncated", 5, 42, "the file ends after 7 fields"),
    "comment": (with_line(3, "# from here on with another seed"), "comment", 3, 1, "a comment"),
    "row commented out": (with_line(3, "#" + ROWS[1]), "comment", 3, 1, "a comment"),
    "second header": (with_line(4, HEAD), "second-header", 4, 1, "a second header"),
    "no id": (row(3, "query_id", ""), "empty-id", 3, 1, 'query_id = ""'),
    "id with a blank": (row(3, "query_id", "test s0001 p2 snap"), "invalid-id", 3, 1, "letters, digits and hyphens"),
    "double": (
        row(4, "query_id", "test-s0000-p0-snap"), "duplicate-id", 4, 1, "line 2 has the same id; delete line 4",
    ),
    "zero quaternion": (row(2, "qw", "0"), "zero-quaternion", 2, QW_COLUMN, "of norm 1, got 0"),
    "quaternion too long": (row(2, "qw", "1.02"), "quaternion-norm", 2, QW_COLUMN, "norm 1, got 1.02; divide"),
    "degrees": (row(2, "qw", "90"), "quaternion-norm", 2, QW_COLUMN, "not angles in degrees"),
    "percent": (row(2, "confidence", "90"), "confidence-range", 2, 51, "divide percent by 100"),
    "negative confidence": (row(2, "confidence", "-0.5"), "confidence-range", 2, 51, "0 to 1"),
    "negative seconds": (row(2, "seconds", "-0.5"), "seconds-range", 2, 55, "-1 when it was not measured"),
    "beyond all tables": (row(2, "x", "1e12"), "position-range", 2, 36, "metres"),
}  # fmt: skip
WARNINGS: dict[str, tuple[str | bytes, str, int | None, int | None, str]] = {
    "byte order mark": (b"\xef\xbb\xbf" + GOOD.encode(), "byte-order-mark", None, None, "byte order mark"),
    "Windows": (GOOD.replace("\n", "\r\n"), "line-endings", None, None, "line endings of Windows"),
    "an old Mac": (GOOD.replace("\n", "\r"), "line-endings", None, None, "line endings of Windows or an old Mac"),
    "empty lines": (with_line(3, "") + "\n", "empty-line", 3, 1, "2 empty lines, the first here"),
    "row of separators": (with_line(3, ",,,,,,,,,"), "empty-line", 3, 1, "1 empty line"),
    "no line end": (GOOD[:-1], "missing-line-ending", 5, None, "the last line has no line ending"),
    "quaternion a little too long": (
        row(2, "qw", "1.002"),
        "quaternion-norm",
        2,
        QW_COLUMN,
        "got 1.002; divide the four by their norm",
    ),
    "one row in millimetres": (row(2, "x", "300"), "position-range", 2, 36, "divide millimetres by 1000"),
    "ids of our own": (row(2, "query_id", "first"), "unusual-ids", None, None, "(first)"),
}
VALID_FOR_READERS = {"header alone"}  # an error for `check` but not for `read_predictions`: no rows


def as_bytes(content: str | bytes) -> bytes:
    return content if isinstance(content, bytes) else content.encode()


def field(name: str, value: str | None) -> str:
    """The valid manifest with another value, or none, for a field."""
    lines = MANIFEST.splitlines()
    i = next(i for i, line in enumerate(lines) if line.startswith(f"{name} ="))
    return "\n".join([*lines[:i], *([] if value is None else [f"{name} = {value}"]), *lines[i + 1 :], ""])


SNAP_ONLY = field("tracks", '["snap"]')
BROKEN_MANIFESTS: dict[str, tuple[str | bytes, str, int | None, str]] = {
    "empty": ("", "empty", None, "is empty"),
    "not TOML": ("method: a\n", "not-toml", 1, "not TOML: Expected '=' after a key"),
    "unclosed": (MANIFEST.replace("predicts.", 'predicts.\n"'), "not-toml", 3, "not TOML"),
    "twice": (MANIFEST + 'method = "b"\n', "not-toml", 16, "Cannot overwrite"),
    "json": ('{"method": "a"}', "not-toml", 1, "not TOML"),
    "deep": ("a = " + "[" * 100_000, "not-toml", None, "not TOML"),
    "long number": ("a = " + "1" * 100_000, "not-toml", None, "not TOML"),
    "bytes": (MANIFEST.encode() + b"\xff", "invalid-byte", 16, "byte 0xFF"),
    "utf-16": (MANIFEST.encode("utf-16"), "not-utf-8", None, "is UTF-16 text"),
    "zip": (b"PK\x03\x04", "binary", None, "zip file"),
    "no method": (field("method", None), "missing-field", None, 'no field method'),
    "no tracks": (field("tracks", None), "missing-field", None, "a list of some of snap, snap-tilt, place"),
    "no learned": (field("learned", None), "missing-field", None, "add a line learned = false"),
    "number": (field("method", "7"), "wrong-type", 1, 'method = "7"'),
    "text for truth": (field("learned", '"no"'), "wrong-type", 9, "without quotes"),
    "text for list": (field("authors", '"A. Name"'), "wrong-type", 2, 'such as ["a", "b"]'),
    "list of numbers": (field("authors", "[1, 2]"), "wrong-type", 2, 'authors = "[1, 2]"'),
    "table": (MANIFEST + "[extra]\na = 1\n", "unknown-field", None, 'table "extra"'),
    "unknown": (MANIFEST + 'trainingdata = "x"\n', "unknown-field", 16, 'field "trainingdata"'),
    "misspelt": (MANIFEST.replace("authors", "auhtors"), "unknown-field", 2, "did you mean authors?"),
    "unknown track": (field("tracks", '["snap", "palce"]'), "unknown-value", 7, "did you mean place?"),
    "no track": (field("tracks", "[]"), "empty-field", 7, "a list of some of"),
    "track twice": (field("tracks", '["snap", "snap"]'), "duplicate-value", 7, "each once"),
    "date": (field("date", '"31.01.2026"'), "invalid-date", 5, "YYYY-MM-DD"),
    "no day": (field("date", '"2026-02-30"'), "invalid-date", 5, 'date = "2026-02-30"'),
    "time": (field("date", "2026-01-31T10:00:00"), "wrong-type", 5, "YYYY-MM-DD"),
    "predicts": (field("predicts", '"rotations"'), "unknown-value", 8, "did you mean rotation?"),
    "camera set": (field("camera_set", '"four"'), "unknown-value", 14, "primary, three, top"),
    "url": (field("url", '"example.org"'), "invalid-url", 4, "with https://"),
    "empty name": (field("method", '" "'), "empty-field", 1, "fill in"),
    "long name": (field("method", f'"{"x" * 100}"'), "too-long", 1, "at most 80 characters"),
    "two lines": (field("method", '"a\\nb"'), "two-lines", 1, "in one line"),
    "long label": (MANIFEST + f'label = "{"x" * 100}"\n', "too-long", 16, "a short name of at most 80 characters"),
    "label of a number": (MANIFEST + "label = 7\n", "wrong-type", 16, 'label = "7"'),
    "two paper rows": (MANIFEST + 'paper_row = ["a", "b"]\n', "wrong-type", 16, "the key of a row of Table I"),
    "paper row in two lines": (MANIFEST + 'paper_row = "a\\nb"\n', "two-lines", 16, "in one line"),
    "control": (field("method", '"a\\u0007"'), "control-character", 1, "control characters"),
}  # fmt: skip
MANIFEST_WARNINGS = {
    "claimed": (
        field("tracks", '["snap", "place", "curves"]'), "empty-track", None, "curves is listed in manifest.toml",
    ),
    "not claimed": (SNAP_ONLY, "unlisted-track", None, "1 rows of track place, which manifest.toml does not list"),
    "left empty": (field("hardware", '""'), "left-empty", None, "hardware left empty"),
    "learned from what": (field("learned", "true"), "left-empty", None, "training_data left empty"),
}  # fmt: skip
