"""The named numbers of each point in a cloud file, and where they stand in a row."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from fusion_core.recordings.clouds.bad_cloud import BadCloud

MAX_POINTS = 1 << 24
"""Set by hand, above the nine million of a turn of half a minute; they take 256 MiB."""
# Set by hand, above any scanner's point: 16 kB of a row, a name for each byte of 4 kB.
_MAX_ROW_BYTES = 1 << 14
_MAX_FIELDS = 1 << 12
_AXES = ("x", "y", "z")
# As PCL, KITTI, nuScenes and CloudCompare call it. The first that the cloud has is taken.
_INTENSITY_NAMES = (
    "intensity",
    "i",
    "reflectance",
    "reflectivity",
    "remission",
    "scalar_intensity",
    "scalar_reflectance",
    "scalar_scalar_intensity",
)


@dataclass(frozen=True, slots=True)
class PointField:
    """``count`` numbers of one name in each point."""

    name: str
    dtype: np.dtype[Any]
    count: int = 1


@dataclass(frozen=True, slots=True)
class Column:
    """A number that is read: its type, the byte at which it stands in a row, and its place among
    the row's words where the file is text."""

    dtype: np.dtype[Any]
    byte: int
    word: int


@dataclass(frozen=True, slots=True)
class PointLayout:
    """The fields of a point in their order. Raises BadCloud for rows beyond the limits."""

    fields: tuple[PointField, ...]

    def __post_init__(self) -> None:
        if len(self.fields) > _MAX_FIELDS or self.row_bytes > _MAX_ROW_BYTES:
            raise BadCloud(
                f"it claims {len(self.fields)} fields of {self.row_bytes} bytes for each point"
            )

    @property
    def row_bytes(self) -> int:
        """Bytes of one point."""
        return sum(field.dtype.itemsize * field.count for field in self.fields)

    @property
    def row_words(self) -> int:
        """Numbers of one point."""
        return sum(field.count for field in self.fields)

    def columns(self) -> tuple[Column, ...]:
        """x, y, z, and the intensity where there is one; names in either case.

        Raises BadCloud where a coordinate is missing.
        """
        placed = dict(self._placed())
        lacking = [axis for axis in _AXES if axis not in placed]
        if lacking:
            names = ", ".join(field.name for field in self.fields[:12])
            raise BadCloud(
                f"it has no field {lacking[0]}; its fields are {names or 'none'}",
                "A cloud needs x, y and z in metres.",
            )
        intensity = next((name for name in _INTENSITY_NAMES if name in placed), None)
        return tuple(placed[name] for name in (*_AXES, *([intensity] if intensity else ())))

    def _placed(self) -> Iterator[tuple[str, Column]]:
        """The fields of one number. Of two with the same name the first counts, so that it is
        yielded last."""
        found: list[tuple[str, Column]] = []
        byte = word = 0
        for field in self.fields:
            if field.count == 1:
                found.append((field.name.lower(), Column(field.dtype, byte, word)))
            byte += field.dtype.itemsize * field.count
            word += field.count
        yield from reversed(found)


def require_count(count: int) -> int:
    """The number of points. Raises BadCloud where there are none, or too many."""
    if not 0 < count <= MAX_POINTS:
        problem = "it has no points" if count == 0 else f"it claims {count} points"
        raise BadCloud(problem, f"A cloud has from 1 to {MAX_POINTS} points.")
    return count
