"""Objects of JSON files: reading an entry that a file lacks is a line that says which and where, never a KeyError."""

from __future__ import annotations

from typing import Any, NoReturn

from kit1000.errors import InputError


class JsonObject(dict[str, Any]):
    """A JSON object; objects in it are such objects too, lists are as they were."""

    def __init__(self, values: dict[str, Any], place: str, repair: str) -> None:
        """place: of the object, such as a file; begins messages. repair: how to mend it; ends them."""
        super().__init__(
            (key, JsonObject(each, f"{place}: {key}", repair) if isinstance(each, dict) else each)
            for key, each in values.items()
        )
        self.place, self.repair = place, repair

    def __missing__(self, key: str) -> NoReturn:
        raise InputError(f"{self.place}: has no {key!r}; {self.repair}")
