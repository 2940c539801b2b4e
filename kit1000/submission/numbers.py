"""Why a field is not a number, and how to repair it."""

from __future__ import annotations

import re

USE_POINT = "write digits with a decimal point, such as 0.25 or 1e-05"
DATE_PATTERN = r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}|\d{1,2}[-. ][a-z]{3}[a-z]*[-. ]?\d*|\d+:\d+(:\d+)?"
OMIT_ROW = "omit the row when there is no prediction; the query then counts as no motion"

# code, pattern of the field, repair; the first match counts
FIELD_PATTERNS = (
    ("empty-field", r"", OMIT_ROW + "; seconds are -1 when not measured"),
    ("nan", r"[+-]?(nan|n/?a|#n/a|null|none|nil|missing|\?|-)(\(.*\))?", OMIT_ROW),
    ("infinity", r"[+-]?(inf|infinity|1\.#inf|∞)", "fix the method: probably a division by zero"),
    ("overflow", r"[+-]?[\d.]+e[+-]?\d+", "fix the method: the number is beyond float64"),
    ("open-quote", r'"[^"]*|[^"]*"', "close the quote or delete it"),
    ("decimal-comma", r"[+-]?\d+,\d+(e[+-]?\d+)?", "write a decimal point instead of the comma"),
    ("digit-separator", r"[+-]?\d{1,3}([_' ,]\d{3})+(\.\d*)?|[+-]?[\d.]*_[\d._]*", "write digits without separators"),
    ("two-decimal-points", r"[+-]?\d*\.\d*(\.\d*)+(e[+-]?\d+)?", USE_POINT),
    ("type-repr", r"(np|numpy|torch)?\.?(float\d*|tensor|array)\(.*", "write repr(float(value))"),
    ("brackets", r"[\[({].*|.*[\])}]", "write only the number"),
    ("unit", r"[+-]?[\d.]+\s*(m|mm|cm|s|ms|sec|rad|deg|degrees|°|%)", "write only the number, in metres or seconds"),
    ("boolean", r"true|false|yes|no", USE_POINT),
    ("fraction", r"[+-]?\d+\s*/\s*\d+", USE_POINT),
    ("date", DATE_PATTERN, "format the column of the spreadsheet as numbers"),
    ("spreadsheet-error", r"#(ref|value|name|div/0|num)[!?]|#+", "repair the formula, or widen the column"),
    ("hexadecimal", r"[+-]?0x[0-9a-f.]+(p[+-]?\d+)?", USE_POINT),
    ("complex", r".*\dj\)?", USE_POINT),
)  # fmt: skip
COMPILED_PATTERNS = tuple(
    (code, re.compile(pattern + r"\Z", re.IGNORECASE | re.ASCII), repair) for code, pattern, repair in FIELD_PATTERNS
)
LONGEST_FIELD = 100  # characters of a field that are compared with patterns
DASHES = str.maketrans(dict.fromkeys("−‐‑‒–—﹣－", "-"))


def number_fault(text: str) -> tuple[str, str]:
    """Code and repair of a field that is not a finite number."""
    plain = text.strip()
    if len(plain) > LONGEST_FIELD:
        return "long-field", "write at most 17 digits"
    for code, pattern, repair in COMPILED_PATTERNS:
        if pattern.match(plain):
            return code, repair
    if not plain.isascii():
        dashes = plain.translate(DASHES)
        digits = dashes.isascii() or all(c.isdigit() or c in "+-.eE" for c in dashes)
        return ("non-ascii-digits", "write ASCII digits and the minus sign -") if digits else ("text", USE_POINT)
    return "text", USE_POINT
