"""Labels of scans as SemanticKITTI has them: a ``.label`` file for each scan.

It holds a little-endian uint32 for each beam, in their order: the class in its lower 16 bits, 0 for
unlabelled and else the label's code + 1, and an instance in the upper ones, which is 0. Instances
that another tool has written are not read. ``classes.yaml`` names the classes as the data set's own
configuration does, under ``labels`` and, blue first, ``color_map``.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from fusion_core.exporting.labels.capture_folder import (
    MaskCoding,
    read_capture_folder,
    write_capture_folder,
)
from fusion_core.exporting.labels.label_file import MASK_VALUES, LabelFile, LabelHeader
from fusion_core.exporting.palette import PALETTE, UNKNOWN
from fusion_core.files.atomic import write_text
from fusion_core.model.conventions import IntArray
from fusion_core.model.labels import CaptureLabels

FORMAT = "semantic-kitti"
_CLASS_BITS = 0xFFFF
_BEAM = np.dtype("<u4")


def write_semantic_kitti(folder: Path, header: LabelHeader, layer: Iterable[CaptureLabels]) -> None:
    """Write into an existing, empty folder. Raises ExportError where it cannot be written."""
    write_text(folder / "classes.yaml", _classes_yaml())
    write_capture_folder(folder, header, layer, _CODING)


def read_semantic_kitti(folder: Path) -> LabelFile:
    """Raises RecordingError."""
    return read_capture_folder(folder, _CODING)


def _encode(values: IntArray) -> bytes:
    return values.astype(_BEAM).tobytes()


def _decode(content: bytes, rows: int, columns: int) -> IntArray:
    size = rows * columns * _BEAM.itemsize
    if len(content) != size:
        raise ValueError(f"it has {len(content)} bytes, and {columns} beams take {size}")
    beams = np.frombuffer(content, _BEAM).astype(np.int64)
    return (beams & _CLASS_BITS).reshape(rows, columns)


def _classes_yaml() -> str:
    colors = {name: PALETTE.get(name, UNKNOWN) for name in MASK_VALUES} | {"unlabelled": "#000000"}
    blue_first = {
        name: [int(hexa[at : at + 2], 16) for at in (5, 3, 1)] for name, hexa in colors.items()
    }
    return "".join(
        [
            "labels:\n",
            *(f"  {value}: {name}\n" for name, value in MASK_VALUES.items()),
            "color_map:\n",
            *(f"  {value}: {blue_first[name]}\n" for name, value in MASK_VALUES.items()),
        ]
    )


_CODING = MaskCoding(
    format=FORMAT,
    suffix=".label",
    encode=_encode,
    decode=_decode,
    # One more shows that the file is too long.
    max_bytes=lambda rows, columns: rows * columns * _BEAM.itemsize + 1,
)
