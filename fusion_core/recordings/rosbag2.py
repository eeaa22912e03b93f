"""ROS 2 recordings: a folder of .mcap or .db3 files with or without metadata.yaml, or one file.

The files themselves are scanned. ``metadata.yaml`` gives the order of split files and is a
cross-check: where it disagrees, the files are right and a warning says so.
"""

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from fusion_core.model.errors import RecordingError
from fusion_core.model.recording import Recording
from fusion_core.recordings.containers import Container
from fusion_core.recordings.indexed import IndexedRecording
from fusion_core.recordings.mcap_file import McapFile
from fusion_core.recordings.sqlite_file import SqliteFile

METADATA = "metadata.yaml"
_CONTAINERS: Mapping[str, type[McapFile] | type[SqliteFile]] = {
    ".mcap": McapFile,
    ".db3": SqliteFile,
}
_NAMES = {".mcap": "MCAP", ".db3": "SQLite"}
# rosbag2 numbers the parts of a split recording: name_0, name_1, ...
_SPLIT_NAME = re.compile(r"(.*)_(\d+)$")
_MAX_METADATA_BYTES = 64 << 20


@dataclass(frozen=True, slots=True)
class _Metadata:
    files: tuple[str, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    compression: str = ""
    problem: str = ""


def is_rosbag2_folder(path: Path) -> bool:
    """Whether a folder holds storage files of ROS 2."""
    return any(child.suffix in _CONTAINERS and child.is_file() for child in path.iterdir())


def open_mcap(path: Path) -> Recording:
    """One .mcap file. Raises RecordingError."""
    return IndexedRecording(path, "MCAP file", [McapFile(path)])


def open_sqlite(path: Path) -> Recording:
    """One .db3 file. Raises RecordingError."""
    return IndexedRecording(path, "ROS 2 SQLite file", [SqliteFile(path)])


def open_rosbag2_folder(path: Path) -> Recording:
    """A folder of ROS 2 storage files. Raises RecordingError."""
    metadata = _read_metadata(path)
    if metadata.compression:
        raise RecordingError(
            f"is compressed by {metadata.compression}, which is not read.",
            file=path,
            advice="Unpack it with `ros2 bag convert`; compressed chunks inside MCAP are fine.",
        )
    files, warnings = _storage_files(path, metadata)
    containers: list[Container] = []
    try:
        for file in files:
            containers.append(_CONTAINERS[file.suffix](file))
    except BaseException:
        for container in containers:
            container.close()
        raise
    recording = IndexedRecording(
        path, f"ROS 2 folder ({_NAMES[files[0].suffix]})", containers, warnings
    )
    recording.warnings.extend(_disagreements(metadata, recording))
    return recording


def _storage_files(path: Path, metadata: _Metadata) -> tuple[list[Path], list[str]]:
    """The files of the recording in order, and what metadata.yaml says otherwise."""
    there = {c.name: c for c in sorted(path.iterdir()) if c.suffix in _CONTAINERS and c.is_file()}
    warnings = [metadata.problem] if metadata.problem else []
    named = [name for name in metadata.files if name in there]
    lost = [name for name in metadata.files if name not in there]
    if lost:
        warnings.append(f"{METADATA} names files that are missing: {', '.join(lost)}.")
    if named:
        extra = [name for name in there if name not in named]
        if extra:
            warnings.append(f"Files that {METADATA} does not name are left out: {extra}.")
        return [there[name] for name in named], warnings
    files = sorted(there.values(), key=_split_order)
    others = sorted(child for child in path.iterdir() if child.suffix == ".bag")
    kinds = {(file.suffix, _split_order(file)[0]) for file in [*files, *others]}
    if len(kinds) > 1:
        names = ", ".join(file.name for file in [*files, *others])
        raise RecordingError(
            f"holds several recordings and no {METADATA} that joins them.",
            file=path,
            advice=f"Name one of them: {names}.",
        )
    return files, warnings


def _split_order(file: Path) -> tuple[str, int]:
    match = _SPLIT_NAME.match(file.stem)
    return (match[1], int(match[2])) if match else (file.stem, -1)


def _read_metadata(path: Path) -> _Metadata:
    file = path / METADATA
    if not file.is_file():
        return _Metadata()
    try:
        if file.stat().st_size > _MAX_METADATA_BYTES:
            raise ValueError("it is too large")
        document = YAML(typ="safe", pure=True).load(file.read_text(encoding="utf-8"))
        return _parse_metadata(document["rosbag2_bagfile_information"])
    except (YAMLError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return _Metadata(problem=f"{METADATA} cannot be read; the files themselves were scanned.")


def _parse_metadata(information: Any) -> _Metadata:
    mode = str(information.get("compression_mode") or "none").lower()
    counts = Counter[str]()
    for topic in information.get("topics_with_message_count") or []:
        counts[str(topic["topic_metadata"]["name"])] += int(topic["message_count"])
    return _Metadata(
        # Old versions wrote the folder's name before the file's.
        files=tuple(Path(name).name for name in information["relative_file_paths"]),
        counts=counts,
        compression="" if mode == "none" else mode,
    )


def _disagreements(metadata: _Metadata, recording: Recording) -> list[str]:
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
    return [f"{METADATA} and the files disagree on counts, the files hold: {'; '.join(differing)}."]
