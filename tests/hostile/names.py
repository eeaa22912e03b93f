"""Names that are bytes and no UTF-8, as other systems and old archives leave them."""

import os
from pathlib import Path

NO_UTF8 = os.fsdecode(b"r\xff\xfe")
"""A name as Python has it, with what is no UTF-8 as lone surrogates."""
SHOWN = r"r\xff\xfe"
"""The same for people."""


def moved_to_no_utf8(path: Path, folder: Path) -> Path:
    """The file in a folder and under a name of which neither is UTF-8."""
    moved = folder / NO_UTF8 / f"{NO_UTF8}{path.suffix}"
    moved.parent.mkdir()
    return path.rename(moved)
