"""The files that come with ScanLoom: pictures and colours (static), built-in recordings (samples).

A wheel holds both folders inside this package; in a checkout they are at its top level.
"""

import json
from pathlib import Path

from fusion_core.model.errors import ScanLoomError

SAMPLE_FRAME = 40
"""A frame of the built-in recording with samples of all classes and repairs of both sensors."""

_PACKAGE = Path(__file__).parent


def static_path(name: str) -> Path:
    """The file ``name`` of the static folder. Raises ScanLoomError where it does not exist."""
    return _find("static", name)


def sample_path(name: str = "furnished_room.mcap") -> Path:
    """The built-in recording ``name``. Raises ScanLoomError where it does not exist."""
    return _find("samples", name)


def palette() -> dict[str, str]:
    """Colour (#RRGGBB) of each noise class, each sensor and the fused result.

    All but the last can be told apart by colour-blind readers, on white and on dark pages.
    """
    colours: dict[str, str] = json.loads(static_path("palette.json").read_text(encoding="utf-8"))
    return colours


def _find(folder: str, name: str) -> Path:
    for parent in (_PACKAGE, _PACKAGE.parents[1]):
        path = parent / folder / name
        if path.exists():
            return path
    raise ScanLoomError(
        "this file of ScanLoom itself is missing.",
        file=f"{folder}/{name}",
        advice="Reinstall ScanLoom.",
    )
