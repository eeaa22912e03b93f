"""Paths below a root: what may be opened there, and the names under which browsers know it.

A browser gets names and sends names, never paths. A name is what a path is relative to its root,
with ``\\xff`` in place of each byte that is not UTF-8. Hidden files and folders are excluded, and
symbolic links are followed only to places inside the root.
"""

import os
import stat
from itertools import islice
from pathlib import Path

from fusion_core.model.errors import RecordingError
from fusion_core.model.names import escape_undecodable

# Names of one folder that are read at most: far more than anyone pages through.
MAX_NAMES = 100_000


def resolve_root(root: Path) -> Path:
    """The real path of a root. Raises RecordingError for what is no folder."""
    if not root.is_dir():
        raise RecordingError(
            "is no folder.", file=root, advice="Name one that holds recordings as --root."
        )
    return Path(os.path.realpath(root))


def path_below(root: Path, name: str) -> Path | None:
    """The resolved path of a file name below a root, None if it may not be opened.

    Allowed are files and folders below the root, unless they or a folder above them are hidden.
    """
    if any(part.startswith(".") for part in Path(name).parts):
        return None
    try:
        path = (root / name).resolve()
        inner = path.relative_to(root).parts
        if not inner or any(part.startswith(".") for part in inner):
            return None
        mode = path.stat().st_mode
    except (OSError, RuntimeError, ValueError):
        # An impossible name, a link that leads out of the root or to itself, or a missing file.
        return None
    return path if stat.S_ISREG(mode) or stat.S_ISDIR(mode) else None


def path_of_shown_name(root: Path, name: str) -> Path | None:
    """As ``path_below``, for a name as browsers know it."""
    # Only names in valid Unicode can be sent to a browser.
    if name != escape_undecodable(name):
        return None
    if (path := path_below(root, name)) is not None:
        return path
    file_name = _undecodable_name(root, name)
    return None if file_name is None else path_below(root, file_name)


def shown_name(root: Path, path: Path) -> str | None:
    """The name of a resolved path below a root; None if another path has that name, or none."""
    if not path.is_relative_to(root):
        return None
    name = escape_undecodable(str(path.relative_to(root)))
    return name if path_of_shown_name(root, name) == path else None


def child_names(folder: Path) -> list[str]:
    """Names of the files and folders of a folder that are not hidden, at most ``MAX_NAMES``:
    folders first, in alphabetical order. Raises OSError."""
    with os.scandir(folder) as children:
        visible = (child for child in children if not child.name.startswith("."))
        first = list(islice(visible, MAX_NAMES))
        return [child.name for child in sorted(first, key=_order)]


def _order(child: os.DirEntry[str]) -> tuple[bool, str, str]:
    shown = escape_undecodable(child.name).casefold()
    return not _is_folder(child), shown, child.name


def _is_folder(child: os.DirEntry[str]) -> bool:
    try:
        return child.is_dir()
    except OSError:
        # A link to itself, for one.
        return False


def _undecodable_name(root: Path, name: str) -> str | None:
    """The file name below a root that is shown as ``name``, None if there is none."""
    parts = Path(name).parts
    # Only an escaped byte makes a name differ from what is shown.
    if "\\x" not in name or any(part.startswith((".", "/")) for part in parts):
        return None
    folder = root
    try:
        for part in parts:
            is_there = (folder / part).exists()
            folder = folder / (part if is_there else _child_shown_as(folder, part))
    except OSError:
        # An impossible name, a missing one, or a folder that cannot be read.
        return None
    return str(folder.relative_to(root))


def _child_shown_as(folder: Path, part: str) -> str:
    """Raises FileNotFoundError."""
    for name in child_names(folder):
        if escape_undecodable(name) == part:
            return name
    raise FileNotFoundError(part)
