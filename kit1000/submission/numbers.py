"""What is wrong with a field that should hold a number."""

from __future__ import annotations

import re

POINT = "write digits with a decimal point, such as 0.25 or 1e-05"
DATE = r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}|\d{1,2}[-. ][a-z]{3}[a-z]*[-. ]?\d*|\d+:\d+(:\d+)?"
NO_ANSWER = "leave out the row when there is no answer: the query then counts as one not moved"

# name, what the field looks like, the repair; the first that fits speaks
LOOKS = (
    ("empty-field", r"", NO_ANSWER + "; seconds are -1 when not measured"),
    ("nan", r"[+-]?(nan|n/?a|#n/a|null|none|nil|missing|\?|-)(\(.*\))?", NO_ANSWER),
    ("infinity", r"[+-]?(inf|infinity|1\.#inf|∞)", "look for a division by zero in the method"),
    ("too-large", r"[+-]?[\d.]+e[+-]?\d+", "look for an overflow in the method"),
    ("open-quote", r'"[^"]*|[^"]*"', "close the quote, or delete it"),
    ("decimal-comma", r"[+-]?\d+,\d+(e[+-]?\d+)?", "write a decimal point instead of the comma"),
    ("thousands-mark", r"[+-]?\d{1,3}([_' ,]\d{3})+(\.\d*)?|[+-]?[\d.]*_[\d._]*", "write the digits without marks"),
    ("two-points", r"[+-]?\d*\.\d*(\.\d*)+(e[+-]?\d+)?", POINT),
    ("repr-of-a-type", r"(np|numpy|torch)?\.?(float\d*|tensor|array)\(.*", "write repr(float(value))"),
    ("brackets", r"[\[({].*|.*[\])}]", "write the number alone"),
    ("unit", r"[+-]?[\d.]+\s*(m|mm|cm|s|ms|sec|rad|deg|degrees|°|%)", "write the number alone, in metres or seconds"),
    ("true-or-false", r"true|false|yes|no", POINT),
    ("fraction", r"[+-]?\d+\s*/\s*\d+", POINT),
    ("date", DATE, "format the column of the spreadsheet as a number"),
    ("sheet-error", r"#(ref|value|name|div/0|num)[!?]|#+", "mend the formula of the spreadsheet, or widen the column"),
    ("hexadecimal", r"[+-]?0x[0-9a-f.]+(p[+-]?\d+)?", POINT),
    ("complex", r".*\dj\)?", POINT),
)  # fmt: skip
PATTERNS = tuple((name, re.compile(look + r"\Z", re.IGNORECASE | re.ASCII), repair) for name, look, repair in LOOKS)
LONGEST = 100  # characters of a field that patterns look at
MINUS = str.maketrans(dict.fromkeys("−‐‑‒–—﹣－", "-"))


def number_fault(text: str) -> tuple[str, str]:
    """Name and repair of a field that holds no finite number."""
    plain = text.strip()
    if len(plain) > LONGEST:
        return "huge-field", "write no more than 17 digits"
    for name, pattern, repair in PATTERNS:
        if pattern.match(plain):
            return name, repair
    if not plain.isascii():
        dashes = plain.translate(MINUS)
        digits = dashes.isascii() or all(c.isdigit() or c in "+-.eE" for c in dashes)
        return ("foreign-digits", "write ASCII digits and the minus sign -") if digits else ("text", POINT)
    return "text", POINT
