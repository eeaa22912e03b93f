"""Which recordings a batch works on, and what each is called."""

import glob
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from fusion_core.exporting.manifest import Manifest
from fusion_core.files.inputs import require_apart
from fusion_core.files.regular_file import read_regular
from fusion_core.model.errors import RecordingError, ScanLoomError
from fusion_core.model.names import escape_undecodable
from fusion_core.recordings.formats import READABLE_FORMATS
from fusion_core.recordings.robot_at_home.rooms import is_robot_at_home
from fusion_core.recordings.rosbag2.compressed_storage import is_storage_file
from fusion_core.workflows.batch.item_names import item_names
from fusion_core.workflows.batch.remote import find_remote, is_address
from fusion_core.workflows.batch.suffixes import has_recording_suffix
from fusion_core.workflows.source import (
    RoomChoice,
    is_recording,
    may_hold_recordings,
    room_choices,
    rooms_of,
)

# A list of a million addresses.
_LIST_BYTES_MAX = 256 << 20


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchItem:
    """A recording of a batch.

    ``name``: of its results, unique in the batch. ``place``: its absolute path, or its address.
    ``recording``: its path relative to the folder that all recordings of the batch lie in, or its
    address. ``robot``: the folder above it in that one, "" where there is none. ``room``: which
    room of the data set at ``place``.
    """

    name: str
    place: str
    recording: str
    robot: str
    room: RoomChoice | None = None

    @property
    def is_remote(self) -> bool:
        return is_address(self.place)


def common_folder(items: Sequence[BatchItem]) -> Path | None:
    """The folder that all recordings lie in; None where there is none, or one is not on disk."""
    folders = set()
    for item in items:
        depth = len(Path(item.recording).parts)
        parents = Path(item.place).parents
        if item.is_remote or depth > len(parents):
            return None
        folders.add(parents[depth - 1])
    return folders.pop() if len(folders) == 1 else None


@dataclass(frozen=True, slots=True)
class _Found:
    """``root``: the folder that names start from. ``given``: what was named and is read.
    ``room``: as in BatchItem."""

    path: Path
    root: Path
    given: Path
    room: RoomChoice | None = None


@dataclass(frozen=True, slots=True)
class _Remote:
    """Addresses of a recording, and of the folder that names start from."""

    address: str
    root: str


def find_items(
    sources: Sequence[str], list_file: Path | None = None, output: Path | None = None
) -> tuple[BatchItem, ...]:
    """The recordings that ``sources`` and the lines of ``list_file`` name, sorted by their places.

    Each is the path of a recording, a folder that is searched for recordings, the root of a data
    set of rooms, or a pattern such as ``robot_*/*.mcap``; or an address of the first two, or a
    pattern of addresses, such as ``s3://bucket/robot_*/*.mcap``. Found are files and folders whose
    content is that of a recording, and files with a recording's suffix even if they are damaged.
    Hidden files and folders of results are passed over. A line of the list that names nothing is
    an item all the same, and fails in its turn.

    Raises RecordingError where nothing is found, and ExportError where ``output`` lies in one of
    them or holds one.
    """
    lines = [] if list_file is None else list(_lines(list_file))
    given = [(source, False) for source in sources] + [(line, True) for line in lines]
    found = [
        each
        for text, is_listed in given
        if not is_address(text)
        for each in _at(text, is_listed=is_listed)
    ]
    remote = [
        _Remote(*each)
        for text, is_listed in given
        if is_address(text)
        for each in _at_address(text, is_listed=is_listed)
    ]
    if not found and not remote:
        raise RecordingError("no recording is named.", advice="Name some, or give a --list.")
    if output is not None:
        require_apart(output, {each.given for each in found})
    return _named(found, remote)


def _lines(list_file: Path) -> Iterator[str]:
    try:
        text = os.fsdecode(read_regular(list_file, _LIST_BYTES_MAX))
    except OSError as error:
        raise RecordingError(
            f"cannot be read as a list: {error.strerror or error}.",
            file=list_file,
            advice="Give a text file with one recording a line.",
        ) from error
    for line in text.splitlines():
        if line.strip() and not line.startswith("#"):
            yield line.strip()


def _at(source: str, *, is_listed: bool) -> Iterator[_Found]:
    """Raises RecordingError where there is nothing, unless it is a line of a list."""
    path = _absolute(source)
    if os.path.lexists(path):
        yield from _given(path)
    elif glob.has_magic(source):
        root, pattern = _split_pattern(source)
        matches = sorted(root.glob(pattern))
        found = [each for match in matches for each in _search(match, root, match, set())]
        if not found:
            raise RecordingError(
                "matches no recording.", file=source, advice="Check the pattern, and quote it."
            )
        yield from found
    elif is_listed:
        yield _Found(path, path.parent, path)
    else:
        raise RecordingError("does not exist.", file=source, advice="Check the path.")


def _at_address(address: str, *, is_listed: bool) -> list[tuple[str, str]]:
    """As ``find_remote``; a line of a list with a recording's suffix is not looked at."""
    if is_listed and has_recording_suffix(address) and not glob.has_magic(address):
        return [(address, address.rpartition("/")[0])]
    return find_remote(address)


def _given(path: Path) -> Iterator[_Found]:
    """What a path that was given stands for. Raises RecordingError for a folder without any."""
    if not path.is_dir():
        yield _Found(path, path.parent, path)
        return
    if _is_one(path):
        yield from _rooms_or_one(path, path.parent, path)
        return
    found = list(_search(path, path, path, set()))
    if not found:
        raise RecordingError("is a folder without a recording.", file=path, advice=READABLE_FORMATS)
    yield from found


def _search(path: Path, root: Path, given: Path, visited: set[str]) -> Iterator[_Found]:
    """The recordings at and below a path, in the order of their names. ``visited``: the real paths
    of the folders searched so far, as links may form a loop."""
    if not path.is_dir():
        if has_recording_suffix(path.name) or is_recording(path):
            yield _Found(path, root, given)
        return
    real = os.path.realpath(path)
    if real in visited or Manifest.read(path).document:
        return
    visited.add(real)
    try:
        if path != root and _is_one(path):
            yield from _rooms_or_one(path, root, given)
            return
        children = sorted(path.iterdir())
    except OSError as error:
        raise RecordingError(
            f"cannot be searched: {error.strerror or error}.",
            file=path,
            advice="Check its permissions.",
        ) from error
    for child in children:
        if not child.name.startswith("."):
            yield from _search(child, root, given, visited)


def _is_one(folder: Path) -> bool:
    """Whether a folder is one recording or one data set, rather than a folder of several files."""
    if not is_recording(folder):
        return False
    if not may_hold_recordings(folder) or is_robot_at_home(folder):
        return True
    # The recorder names a split recording's files for their folder.
    files = [child for child in folder.iterdir() if is_storage_file(child)]
    return all(file.name.startswith(f"{folder.name}_") for file in files)


def _rooms_or_one(path: Path, root: Path, given: Path) -> Iterator[_Found]:
    if is_robot_at_home(path):
        try:
            rooms = rooms_of(path, None)
        except ScanLoomError:
            # A damaged one fails in its turn, and says why.
            rooms = ()
        if len(rooms) > 1:
            yield from (_Found(path, root, given, room) for room in room_choices(rooms))
            return
    yield _Found(path, root, given)


def _named(found: Sequence[_Found], remote: Sequence[_Remote]) -> tuple[BatchItem, ...]:
    """Each once, however often it was found."""
    local = {(os.path.realpath(each.path), each.room): each for each in found}
    kept = sorted(local.values(), key=lambda each: (str(each.path), str(each.room)))
    common = os.path.commonpath({str(each.root) for each in found} or {"/"})
    places = [each.path.relative_to(common).as_posix() for each in kept]
    rooms = [None if each.room is None else str(each.room) for each in kept]
    full = [place + (f"/{room}" if room else "") for place, room in zip(places, rooms, strict=True)]

    addresses = sorted({each.address: each for each in remote}.values(), key=lambda e: e.address)
    roots = {_path_of(each.root) for each in addresses}
    below = [_path_of(each.address) for each in addresses]
    if addresses and not kept:
        shared = os.path.commonpath(roots)
        below = [str(PurePosixPath(path).relative_to(shared)) for path in below]
    else:
        # Beside local ones, an address is told by the whole of it.
        below = [path.lstrip("/") for path in below]
    names = item_names([*full, *below])
    items = [
        BatchItem(
            name=name,
            place=str(each.path),
            recording=escape_undecodable(recording),
            robot=_robot(place) if each.room is None else each.room.session,
            room=each.room,
        )
        for name, each, place, recording in zip(names[: len(kept)], kept, places, full, strict=True)
    ]
    items += [
        BatchItem(name=name, place=each.address, recording=each.address, robot=_robot(place))
        for name, each, place in zip(names[len(kept) :], addresses, below, strict=True)
    ]
    return tuple(items)


def _path_of(address: str) -> str:
    """An address as an absolute path, its scheme the first part."""
    scheme, _, path = address.partition("://")
    return "/".join(["", scheme, *PurePosixPath(path.lstrip("/")).parts])


def _robot(place: str) -> str:
    return escape_undecodable(PurePosixPath(place).parent.name)


def _split_pattern(pattern: str) -> tuple[Path, str]:
    """The folder that a pattern begins with, and the rest."""
    parts = Path(pattern).parts
    plain = next(n for n, part in enumerate(parts) if glob.has_magic(part))
    return _absolute(str(Path(*parts[:plain]))), str(Path(*parts[plain:]))


def _absolute(text: str) -> Path:
    """A path keeps its own name where it is a link."""
    path = Path(text)
    if path.name in ("", ".."):
        return path.resolve()
    return path.parent.resolve() / path.name
