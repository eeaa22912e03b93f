"""The names that recordings have."""

_SUFFIXES = (".bag", ".mcap", ".db3")
_PACKED_SUFFIXES = ("", ".zstd", ".zst", ".lz4")
_ALL = tuple(suffix + packed for suffix in _SUFFIXES for packed in _PACKED_SUFFIXES)


def has_recording_suffix(name: str) -> bool:
    """Whether a file's name is that of a bag or of a storage file of ROS 2, plain or packed."""
    return name.lower().endswith(_ALL)
