"""The arrays of a truth file (.npz), with limits on its size, since it may come from anywhere."""

import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fusion_core.files.regular_file import open_regular

# Depths and classes of ten minutes of 640 x 480 pixels at 15 images a second unpack to 8 GB.
_MAX_PACKED_BYTES = 4 << 30
_MAX_UNPACKED_BYTES = 8 << 30
# What numpy, zipfile and zlib raise for a file that is damaged or not an archive of arrays.
UNREADABLE_ARRAYS = (
    ValueError,
    EOFError,
    MemoryError,
    NotImplementedError,
    RuntimeError,
    zipfile.BadZipFile,
    zlib.error,
)


def read_arrays(
    path: Path, names: Collection[str] | None = None
) -> dict[str, npt.NDArray[np.generic]]:
    """The arrays of the file by name: all of them, or those of ``names`` that it has.

    Raises OSError where the file cannot be read, is not a regular file or is too large, and one of
    ``UNREADABLE_ARRAYS`` where it holds no arrays.
    """
    with open_regular(path, _MAX_PACKED_BYTES) as file:
        with zipfile.ZipFile(file) as archive:
            unpacked = sum(member.file_size for member in archive.infolist())
        if unpacked > _MAX_UNPACKED_BYTES:
            raise ValueError(f"it unpacks to more than {_MAX_UNPACKED_BYTES} bytes")
        with np.load(file, allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays if names is None or name in names}
