"""OpenCalib's JSON: one sensor, or one pair of sensors, under its name."""

from collections.abc import Mapping
from typing import Any


def opencalib_entry(document: Mapping[str, Any], key: str) -> Mapping[str, Any] | None:
    """The entry whose ``param`` has ``key``, with that value and the others of ``param`` beside the
    entry's own keys. None where there is not exactly one."""
    found = [
        {**entry, **entry["param"]}
        for entry in document.values()
        if isinstance(entry, dict)
        and isinstance(entry.get("param"), dict)
        and key in entry["param"]
    ]
    return found[0] if len(found) == 1 else None
