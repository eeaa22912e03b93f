"""The recordings that a browser has opened last, kept by the browser: names only."""

from collections.abc import Sequence

from pydantic import TypeAdapter, ValidationError

from scanloom.state.view import MAX_NAME_CHARACTERS

# One row of buttons or two.
MAX_RECENT = 8
_NAMES = TypeAdapter(list[str])


def parse_recent(stored: str | None) -> list[str]:
    """The names, the latest first, from what a browser has kept; it may be anything."""
    if stored is None:
        return []
    try:
        names = _NAMES.validate_json(stored)
    except ValidationError:
        return []
    return [name for name in names[:MAX_RECENT] if 0 < len(name) <= MAX_NAME_CHARACTERS]


def with_recent(names: Sequence[str], name: str) -> str:
    """What the browser is to keep once it has opened ``name``."""
    others = (other for other in names if other != name)
    return _NAMES.dump_json([name, *others][:MAX_RECENT]).decode()
