"""Arrays as .npz files: the same bytes for the same arrays."""

import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fusion_core.files.atomic import atomic_stream


def npz_entry(name: str) -> zipfile.ZipInfo:
    """The entry of an array, packed. Its date is in 1980, whenever it is written."""
    entry = zipfile.ZipInfo(f"{name}.npy")
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry


def write_arrays(path: Path, arrays: Mapping[str, npt.NDArray[np.generic]]) -> None:
    """Write arrays by name, aside and then renamed."""
    with atomic_stream(path) as file, zipfile.ZipFile(file, "w") as archive:
        for name, array in arrays.items():
            with archive.open(npz_entry(name), "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
