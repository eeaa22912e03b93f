"""Ground truth of a recording: one .npz beside it, written frame by frame, the same each time."""

import json
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO

import numpy as np
import numpy.typing as npt

from fusion_core.files.atomic import atomic_stream, cannot_write
from fusion_core.files.npz import npz_entry
from fusion_core.settings import StageSettings

_CHUNK_BYTES = 1 << 20


def truth_path(recording: Path) -> Path:
    """The path of a recording's ground truth: ``NAME.mcap`` has ``NAME.truth.npz`` beside it."""
    return recording.with_name(f"{recording.stem}.truth.npz")


def simulated_errors(**noise: StageSettings) -> npt.NDArray[np.str_]:
    """What a truth states of the errors that were put in: the noise settings of each source, as
    one text of JSON, ``{"wheel": {"distance_scale": 1.02, ...}, ...}``."""
    return np.array(json.dumps({name: settings.model_dump() for name, settings in noise.items()}))


class TruthWriter:
    """Collects stacks of equally shaped frames on disk, and zips them at the end.

    The file appears under its name when the ``with`` block ends well; after an error nothing is
    left behind. Dates inside the zip are those of 1980.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._fixed: dict[str, npt.NDArray[np.generic]] = {}
        self._stacks: dict[str, _Stack] = {}

    def put(self, arrays: Mapping[str, npt.NDArray[np.generic]]) -> None:
        """Whole arrays."""
        self._fixed.update(arrays)

    def append(self, name: str, frame: npt.NDArray[np.generic]) -> None:
        """One more frame of a stack; its first axis counts the frames."""
        if name not in self._stacks:
            self._stacks[name] = _Stack(frame.shape, frame.dtype)
        self._stacks[name].append(frame)

    def __enter__(self) -> "TruthWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        try:
            if kind is None:
                self._write()
        except OSError as error:
            raise cannot_write(self.path, error) from error
        finally:
            for stack in self._stacks.values():
                stack.close()

    def _write(self) -> None:
        with atomic_stream(self.path) as file, zipfile.ZipFile(file, "w") as archive:
            for name, array in self._fixed.items():
                with archive.open(npz_entry(name), "w") as member:
                    np.lib.format.write_array(member, array, allow_pickle=False)
            for name, stack in self._stacks.items():
                with archive.open(npz_entry(name), "w", force_zip64=True) as member:
                    stack.copy_to(member)


class _Stack:
    """Frames of one shape and type in a nameless file."""

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype[np.generic]) -> None:
        self._shape = shape
        self._dtype = dtype
        self._count = 0
        # Closed by ``close``: it lives as long as the writer, not as a block of code.
        self._file: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115

    def append(self, frame: npt.NDArray[np.generic]) -> None:
        if frame.shape != self._shape or frame.dtype != self._dtype:
            raise ValueError(f"a frame is {frame.shape} {frame.dtype}, not {self._shape}")
        self._file.write(np.ascontiguousarray(frame).tobytes())
        self._count += 1

    def copy_to(self, member: IO[bytes]) -> None:
        header = {
            "descr": np.lib.format.dtype_to_descr(self._dtype),
            "fortran_order": False,
            "shape": (self._count, *self._shape),
        }
        np.lib.format.write_array_header_1_0(member, header)
        self._file.seek(0)
        while chunk := self._file.read(_CHUNK_BYTES):
            member.write(chunk)

    def close(self) -> None:
        self._file.close()
