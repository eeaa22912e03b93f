"""What a folder below a root holds, for choosing a recording: page by page, by content."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fusion_core.model.names import escape_undecodable
from fusion_core.workflows.source import is_recording, may_hold_recordings
from scanloom.state.allowed_paths import MAX_NAMES, child_names, path_below

# Rows of a page; more are not looked through.
PAGE_ROWS = 50
# Names that are examined for one page, at about half a millisecond each: a folder of images or of
# texts is not read to its end before something is shown.
_MAX_EXAMINED = 2_000


@dataclass(frozen=True, slots=True)
class FolderPlace:
    """A folder below a root. ``find``: only names with this text in them; ``start``: the place of
    the page's first name among them."""

    root: Path
    folder: Path
    find: str = ""
    start: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderRow:
    """A recording, or a folder that can be entered, or what may be either.

    ``label``: its own name, for display. ``path``: resolved, below the root.
    """

    label: str
    path: Path
    is_recording: bool
    is_folder: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderPage:
    """``left_out``: how many of the examined names are no recordings. ``next_start``: where the
    next page begins, None after the last. ``count``: of names that are found. ``problem``: why the
    folder could not be read, or what of it was left out."""

    rows: tuple[FolderRow, ...] = ()
    left_out: int = 0
    next_start: int | None = None
    count: int = 0
    problem: str = ""


def read_page(place: FolderPlace, check: Callable[[], None] = lambda: None) -> FolderPage:
    """One page of a folder: folders first, in alphabetical order.

    ``check`` is called for each name and may raise to end it.
    """
    try:
        names = child_names(place.folder)
    except OSError as error:
        return FolderPage(problem=f"This folder cannot be read: {error.strerror or error}.")
    problem = ""
    if len(names) == MAX_NAMES:
        problem = f"It holds too many names: others than these {MAX_NAMES:,} are left out."
    wanted = place.find.strip().casefold()
    found = [name for name in names if wanted in escape_undecodable(name).casefold()]
    rows: list[FolderRow] = []
    left_out = 0
    position = place.start
    for position in range(place.start, min(place.start + _MAX_EXAMINED, len(found))):
        if len(rows) == PAGE_ROWS:
            break
        check()
        row = _row(place, found[position])
        if row is None:
            left_out += 1
        else:
            rows.append(row)
    else:
        position = min(place.start + _MAX_EXAMINED, len(found))
    return FolderPage(
        rows=tuple(rows),
        left_out=left_out,
        next_start=position if position < len(found) else None,
        count=len(found),
        problem=problem,
    )


def _row(place: FolderPlace, name: str) -> FolderRow | None:
    """None for what is neither a recording nor a folder, or may not be opened."""
    path = path_below(place.root, str(place.folder.relative_to(place.root) / name))
    if path is None:
        return None
    try:
        is_folder = path.is_dir()
        recognised = is_recording(path)
        if recognised and is_folder:
            is_folder = may_hold_recordings(path)
    except OSError:
        # Removed meanwhile, or in a folder that may not be read.
        return None
    if not recognised and not is_folder:
        return None
    label = escape_undecodable(name)
    return FolderRow(label=label, path=path, is_recording=recognised, is_folder=is_folder)
