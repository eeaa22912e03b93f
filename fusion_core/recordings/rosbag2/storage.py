"""ROS 2 recordings: a folder of storage files with or without metadata.yaml, or one file.

The files themselves are scanned. ``metadata.yaml`` gives the order of split files and is a
cross-check: where it disagrees, the files are used and a warning is given. If a file of a folder is
missing or cannot be read, only its own messages are lost.
"""

import re
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

from fusion_core.model.errors import RecordingError
from fusion_core.model.recording import Recording
from fusion_core.recordings.indexed import IndexedRecording
from fusion_core.recordings.rosbag2.compressed_storage import (
    StorageFile,
    is_storage_file,
    uncompressed_name,
)
from fusion_core.recordings.rosbag2.metadata import METADATA, Metadata, read_metadata

# rosbag2 numbers the parts of a split recording: name_0, name_1, ...
_SPLIT_NAME = re.compile(r"(.*)_(\d{1,9})")
_MAX_LISTED = 20


def is_rosbag2_folder(path: Path) -> bool:
    """Whether a folder holds storage files of ROS 2, plain or compressed."""
    return any(is_storage_file(child) for child in path.iterdir())


def open_storage_file(path: Path) -> Recording:
    """One .mcap or .db3 file, plain or compressed by zstd or lz4. Raises RecordingError."""
    file = StorageFile(path)
    format = "MCAP file" if file.kind == "MCAP" else f"ROS 2 {file.kind} file"
    return IndexedRecording(path, format, [file])


def open_rosbag2_folder(path: Path) -> Recording:
    """A folder of ROS 2 storage files. Raises RecordingError where none of them can be read."""
    metadata = read_metadata(path)
    if metadata.message_compression not in ("", "zstd"):
        raise RecordingError(
            f"holds messages compressed by {metadata.message_compression}, which is not read.",
            file=path,
            advice="Unpack it with `ros2 bag convert`.",
        )
    parts, warnings = _order_files(path, metadata)
    files: list[StorageFile] = []
    first_failure = None
    try:
        for part in parts:
            try:
                files.append(StorageFile(part))
            except RecordingError as error:
                warnings.append(f"{part.name} is left out: it {error.problem}")
                first_failure = first_failure or error
            except OSError as error:
                warnings.append(f"{part.name} is left out: {error.strerror or error}.")
        if not files:
            raise first_failure or RecordingError(
                "holds no file that can be opened.", file=path, advice="Check its permissions."
            )
    except BaseException:
        for file in files:
            file.close()
        raise
    kinds = " and ".join(sorted({file.kind for file in files}))
    recording = IndexedRecording(path, f"ROS 2 folder ({kinds})", [*files], warnings)
    recording.warnings.extend(_compare_counts(metadata, recording))
    return recording


def _order_files(path: Path, metadata: Metadata) -> tuple[list[Path], list[str]]:
    """The files of the recording in order, and what is wrong with their number."""
    warnings = [metadata.problem] if metadata.problem else []
    there = _storage_files(path)
    named = list(dict.fromkeys(uncompressed_name(name) for name in metadata.files))
    if not any(name in there for name in named):
        parts = sorted(there, key=_split_order)
        _require_one_recording(path, [there[name] for name in parts])
    else:
        # A recorder that was killed has not listed its last parts.
        stems = {_split_order(name)[0] for name in named}
        unlisted = [name for name in there if name not in named]
        extra = sorted(name for name in unlisted if _split_order(name)[0] not in stems)
        joined = sorted(set(unlisted) - set(extra), key=_split_order)
        if joined:
            warnings.append(f"{METADATA} does not name {_join_names(joined)}, read all the same.")
        if extra:
            warnings.append(
                f"Files that {METADATA} does not name are left out: {_join_names(extra)}."
            )
        parts = [name for name in named if name in there] + joined
    lost = [name for name in named if name not in there]
    if lost:
        warnings.append(f"{METADATA} names files that are missing: {_join_names(lost)}.")
    else:
        warnings += _find_missing_parts([_split_order(name) for name in parts])
    return [there[name] for name in parts], warnings


def _storage_files(path: Path) -> dict[str, Path]:
    """The storage files of a folder by their names without compression."""
    there: dict[str, Path] = {}
    for child in sorted(path.iterdir()):
        # `ros2 bag play` leaves a decompressed part beside the compressed one: of the two the
        # decompressed one comes first, and is used.
        if is_storage_file(child):
            there.setdefault(uncompressed_name(child.name), child)
    return there


def _require_one_recording(path: Path, parts: list[Path]) -> None:
    others = sorted(child for child in path.iterdir() if child.suffix == ".bag")
    recordings = {
        (Path(name).suffix, _split_order(name)[0])
        for name in (uncompressed_name(file.name) for file in [*parts, *others])
    }
    if len(recordings) > 1:
        raise RecordingError(
            f"holds several recordings and no {METADATA} that joins them.",
            file=path,
            advice=f"Name one of them: {_join_names(file.name for file in [*parts, *others])}.",
        )


def _split_order(name: str) -> tuple[str, int]:
    stem = Path(name).stem
    match = _SPLIT_NAME.fullmatch(stem)
    return (match[1], int(match[2])) if match else (stem, -1)


def _find_missing_parts(orders: list[tuple[str, int]]) -> list[str]:
    """Warnings of parts that are missing between others, by their numbers."""
    warnings = []
    for (stem, before), (next_stem, after) in pairwise(orders):
        if stem == next_stem and before >= 0 and after > before + 1:
            lost = f"{stem}_{before + 1}"
            if after > before + 2:
                lost += f" to {stem}_{after - 1}"
            warnings.append(f"Parts of the recording are missing: {lost}.")
    return warnings


def _compare_counts(metadata: Metadata, recording: Recording) -> list[str]:
    if metadata.problem or not metadata.files:
        return []
    found = {topic.name: topic.count for topic in recording.topics}
    differing = [
        f"{name} {metadata.counts.get(name, 0)} against {found.get(name, 0)}"
        for name in sorted({*metadata.counts, *found})
        if metadata.counts.get(name, 0) != found.get(name, 0)
    ]
    if not differing:
        return []
    listed = _join_names(differing, "; ")
    return [f"{METADATA} and the files disagree on counts, the files hold: {listed}."]


def _join_names(names: Iterable[str], separator: str = ", ") -> str:
    names = list(names)
    shown = separator.join(names[:_MAX_LISTED])
    return shown if len(names) <= _MAX_LISTED else f"{shown} and {len(names) - _MAX_LISTED} more"
