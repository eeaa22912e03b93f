"""metadata.yaml of rosbag2 folders: which files belong together, and how many messages they had.

Recordings are read from the files themselves. metadata.yaml is a cross-check only, so problems with
it are warnings and no errors.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.constructor import SafeConstructor
from ruamel.yaml.error import YAMLError
from ruamel.yaml.nodes import MappingNode

METADATA = "metadata.yaml"
# Enough for a thousand parts and some hundred topics; parsing that takes seconds.
_MAX_BYTES = 1 << 20
_MAX_NAME_CHARS = 1024
_MERGE = "tag:yaml.org,2002:merge"


@dataclass(frozen=True, slots=True)
class Metadata:
    """``files``: names without folders, in order. ``counts``: messages by topic.

    ``message_compression``: the format of compressed messages, empty if they are not compressed.
    ``problem``: why the file cannot be read, empty if it can or if there is none.
    """

    files: tuple[str, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    message_compression: str = ""
    problem: str = ""


def read_metadata(folder: Path) -> Metadata:
    """What metadata.yaml of a folder says; empty where there is none."""
    file = folder / METADATA
    if not file.is_file():
        return Metadata()
    try:
        with file.open("rb") as stream:
            content = stream.read(_MAX_BYTES + 1)
        if len(content) > _MAX_BYTES:
            raise ValueError("it is too large")
        yaml = YAML(typ="safe", pure=True)
        yaml.Constructor = _WithoutMerges
        return _parse(yaml.load(content.decode())["rosbag2_bagfile_information"])
    except (
        YAMLError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        RecursionError,
        OverflowError,
        OSError,
    ):
        return Metadata(problem=f"{METADATA} cannot be read; the files themselves were scanned.")


class _WithoutMerges(SafeConstructor):
    """Refuses merge keys, which rosbag2 does not write: nested, they grow exponentially."""

    def flatten_mapping(self, node: MappingNode) -> Any:
        if any(key.tag == _MERGE for key, _ in node.value):
            raise ValueError("it has merge keys")
        return super().flatten_mapping(node)


def _parse(information: Any) -> Metadata:
    counts = Counter[str]()
    for topic in information.get("topics_with_message_count") or []:
        count = topic["message_count"]
        if not isinstance(count, int):
            raise ValueError("a count is no number")
        counts[_require_name(topic["topic_metadata"]["name"])] += count
    mode = _require_name(information.get("compression_mode") or "none").lower()
    packing = _require_name(information.get("compression_format") or "")
    return Metadata(
        # Old versions wrote the folder's name before the file's.
        files=tuple(Path(_require_name(name)).name for name in information["relative_file_paths"]),
        counts=counts,
        message_compression=packing if mode == "message" else "",
    )


def _require_name(value: Any) -> str:
    """A printable text on one line. Anything else may be an endless tree of aliases."""
    if not isinstance(value, str) or len(value) > _MAX_NAME_CHARS or not value.isprintable():
        raise ValueError("a name is no name")
    return value
