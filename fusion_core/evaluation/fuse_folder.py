"""Reading what ``fuse`` wrote: alignment.json, frames.csv and, in batches, samples.parquet."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, fields
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fusion_core.files.regular_file import open_regular, read_regular
from fusion_core.model.classes import NoiseClass, RepairSource
from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.rig import MOUNT_PARAMETERS, Mount

if TYPE_CHECKING:
    import pyarrow as pa

MISSING = -1
"""Null in integer columns, which have no NaN."""

_BATCH_ROWS = 1 << 16
_SOURCES = [source.name.lower() for source in RepairSource]
_FRAME_KEYS = ("camera", "stamp_ns", "scan_stamp_ns")
_FRAME_NUMBERS = ("u", "u_alone", "overlap", "mean_error_m")
# The alignment of a hundred cameras takes some 100 kB.
_MAX_BYTES = 64 << 20
_ADVICE = "Give the folder that scanloom fuse wrote."


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedLidar:
    """The LiDAR's beams, and the samples of its curve (Psi)."""

    angle_min_rad: float
    angle_increment_rad: float
    beams: int
    range_max_m: float
    samples: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedCamera:
    """A camera's recorded intrinsics and its estimated mount, each None where it is unknown."""

    topic: str
    width: int
    height: int
    intrinsics: tuple[float, float, float, float] | None
    T_lidar_camera: FloatArray | None


@dataclass(frozen=True, slots=True, kw_only=True)
class FuseFolder:
    """An opened result folder. ``alignment`` is the content of alignment.json."""

    path: Path
    alignment: dict[str, Any]
    lidar: RecordedLidar
    cameras: tuple[RecordedCamera, ...]

    @property
    def topics(self) -> list[str]:
        """Topics of the cameras, in the order of the camera codes."""
        return [camera.topic for camera in self.cameras]


@dataclass(frozen=True, slots=True, kw_only=True)
class Frames:
    """frames.csv as columns of equal length F; ``camera`` indexes the folder's cameras.

    ``scan_stamp_ns`` is MISSING where the image found no scan. ``number`` holds every other
    numeric column, NaN for null; u, u_alone, overlap and mean_error_m are always there.
    """

    camera: IntArray
    stamp_ns: IntArray
    scan_stamp_ns: IntArray
    number: dict[str, FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True)
class Samples:
    """Some rows of samples.parquet, as columns of equal length.

    Integers are MISSING and metres NaN for null. Sources are codes of RepairSource.
    """

    camera: IntArray
    stamp_ns: IntArray
    scan_stamp_ns: IntArray
    lidar_beam: IntArray
    depth_row: IntArray
    depth_column: IntArray
    lidar_class: IntArray
    depth_class: IntArray
    residual_m: FloatArray
    lidar_raw_m: FloatArray
    lidar_repaired_m: FloatArray
    lidar_source: IntArray
    depth_raw_m: FloatArray
    depth_repaired_m: FloatArray
    depth_source: IntArray

    @property
    def paired(self) -> IntArray:
        """Row numbers of the beams whose point lies in the image."""
        return np.flatnonzero(self.depth_row != MISSING)


def open_fuse_folder(path: Path) -> FuseFolder:
    """Read alignment.json. Raises ScanLoomError where it is missing or lacks an entry."""
    file = path / "alignment.json"
    try:
        alignment = json.loads(read_regular(file, _MAX_BYTES))
        lidar = alignment["lidar"]
        return FuseFolder(
            path=path,
            alignment=alignment,
            lidar=RecordedLidar(
                angle_min_rad=float(lidar["angle_min_rad"]),
                angle_increment_rad=float(lidar["angle_increment_rad"]),
                beams=int(lidar["beams"]),
                # None where the driver sets no limit.
                range_max_m=float(inf if lidar["range_max_m"] is None else lidar["range_max_m"]),
                samples=int(lidar["samples"]),
            ),
            cameras=tuple(_recorded_camera(entry) for entry in alignment["cameras"]),
        )
    except OSError as error:
        raise ScanLoomError(f"cannot be read: {error}.", file=file, advice=_ADVICE) from error
    except (KeyError, TypeError, ValueError) as error:
        raise _not_an_alignment(file, error) from error


def read_mount(folder: FuseFolder) -> Mount:
    """The mount that the frames were fused with, and what is known of its errors."""
    alignment = folder.alignment
    try:
        return Mount.from_vector(
            np.array([float(alignment["mount_used"][name]) for name in MOUNT_PARAMETERS]),
            tuple(alignment[f"{name}_sd"] for name in MOUNT_PARAMETERS),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise _not_an_alignment(folder.path / "alignment.json", error) from error


def read_roll_rad(folder: FuseFolder) -> float:
    """The roll by the floor that the cameras' poses have on the rig, 0 where they have none."""
    return float(folder.alignment.get("roll_used_rad", 0.0))


def _not_an_alignment(file: Path, error: Exception) -> ScanLoomError:
    return ScanLoomError(
        f"is not an alignment as fuse writes it ({type(error).__name__}: {error}).",
        file=file,
        advice=_ADVICE,
    )


def _recorded_camera(entry: dict[str, Any]) -> RecordedCamera:
    intrinsics = [entry[name] for name in ("fx", "fy", "cx", "cy")]
    mount = entry["T_lidar_camera"]
    return RecordedCamera(
        topic=str(entry["topic"]),
        width=int(entry["width"]),
        height=int(entry["height"]),
        intrinsics=None
        if None in intrinsics
        else (
            float(intrinsics[0]),
            float(intrinsics[1]),
            float(intrinsics[2]),
            float(intrinsics[3]),
        ),
        T_lidar_camera=None if mount is None else np.array(mount, dtype=np.float64).reshape(4, 4),
    )


def read_frames_table(folder: FuseFolder) -> "pa.Table":
    """frames.csv as it is: one row for each depth image, in the file's order."""
    import pyarrow as pa
    import pyarrow.csv

    file = folder.path / "frames.csv"
    try:
        # As a stream: Arrow rejects paths that are not UTF-8.
        with open_regular(file) as stream:
            table = pyarrow.csv.read_csv(stream)
    except (OSError, pa.ArrowInvalid) as error:
        raise ScanLoomError(f"cannot be read: {error}.", file=file, advice=_ADVICE) from error
    _require_columns(table.column_names, _FRAME_KEYS + _FRAME_NUMBERS, file)
    return table


def read_frames(folder: FuseFolder) -> Frames:
    """frames.csv as arrays: one row for each depth image, in the file's order."""
    file = folder.path / "frames.csv"
    table = read_frames_table(folder)
    columns = dict(zip(table.column_names, table.columns, strict=True))
    number = {
        name: _as_floats(column)
        for name, column in columns.items()
        if name not in _FRAME_KEYS and _is_numeric(column.type)
    }
    return Frames(
        camera=_as_codes(columns["camera"], folder.topics, "camera", file),
        stamp_ns=_as_integers(columns["stamp_ns"]),
        scan_stamp_ns=_as_integers(columns["scan_stamp_ns"]),
        number=number,
    )


def read_samples(folder: FuseFolder) -> Iterator[Samples]:
    """samples.parquet in batches of bounded size, in the file's order.

    Raises ScanLoomError for a file that cannot be read, lacks a column, or has a class, source,
    beam or pixel that does not exist.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = folder.path / "samples.parquet"
    wanted = tuple(field.name for field in fields(Samples))
    try:
        with open_regular(file) as stream, pq.ParquetFile(stream) as parquet:
            _require_columns(parquet.schema_arrow.names, wanted, file)
            for batch in parquet.iter_batches(batch_size=_BATCH_ROWS, columns=list(wanted)):
                columns = dict(zip(wanted, batch.select(wanted), strict=True))
                yield _parse_samples(folder, columns, file)
    except (OSError, pa.ArrowInvalid) as error:
        raise ScanLoomError(f"cannot be read: {error}.", file=file, advice=_ADVICE) from error


def _parse_samples(folder: FuseFolder, columns: dict[str, Any], file: Path) -> Samples:
    samples = Samples(
        camera=_as_codes(columns["camera"], folder.topics, "camera", file),
        stamp_ns=_as_integers(columns["stamp_ns"]),
        scan_stamp_ns=_as_integers(columns["scan_stamp_ns"]),
        lidar_beam=_as_integers(columns["lidar_beam"]),
        depth_row=_as_integers(columns["depth_row"]),
        depth_column=_as_integers(columns["depth_column"]),
        lidar_class=_as_integers(columns["lidar_class"]),
        depth_class=_as_integers(columns["depth_class"]),
        residual_m=_as_floats(columns["residual_m"]),
        lidar_raw_m=_as_floats(columns["lidar_raw_m"]),
        lidar_repaired_m=_as_floats(columns["lidar_repaired_m"]),
        lidar_source=_as_codes(columns["lidar_source"], _SOURCES, "lidar_source", file),
        depth_raw_m=_as_floats(columns["depth_raw_m"]),
        depth_repaired_m=_as_floats(columns["depth_repaired_m"]),
        depth_source=_as_codes(columns["depth_source"], _SOURCES, "depth_source", file),
    )
    height = np.array([camera.height for camera in folder.cameras])[samples.camera]
    width = np.array([camera.width for camera in folder.cameras])[samples.camera]
    _require_within(samples.lidar_beam, 0, folder.lidar.beams, "lidar_beam", file)
    _require_within(samples.lidar_class, 0, len(NoiseClass), "lidar_class", file)
    _require_within(samples.depth_row, MISSING, height, "depth_row", file)
    row = samples.paired
    _require_within(samples.depth_column[row], 0, width[row], "depth_column", file)
    _require_within(samples.depth_class[row], 0, len(NoiseClass), "depth_class", file)
    return samples


def _require_columns(present: list[str], wanted: tuple[str, ...], file: Path) -> None:
    absent = [name for name in wanted if name not in present]
    if absent:
        raise ScanLoomError(f"has no column {', '.join(absent)}.", file=file, advice=_ADVICE)


def _require_within(
    values: IntArray, low: int, below: int | IntArray, name: str, file: Path
) -> None:
    bad = (values < low) | (values >= below)
    if bad.any():
        raise ScanLoomError(
            f"{name} holds {values[bad][0]}, which is out of range.", file=file, advice=_ADVICE
        )


def _as_codes(column: Any, names: list[str], what: str, file: Path) -> IntArray:
    """Positions of strings in ``names``, MISSING for null."""
    import pyarrow as pa
    import pyarrow.compute as pc

    strings = column.cast(pa.string())
    codes = _as_integers(pc.index_in(strings, value_set=pa.array(names, pa.string())))
    unknown = (codes == MISSING) & strings.is_valid().to_numpy(zero_copy_only=False)
    if unknown.any():
        first = strings[int(np.flatnonzero(unknown)[0])]
        raise ScanLoomError(
            f"{what} {str(first)!r} is not one of {', '.join(names)}.", file=file, advice=_ADVICE
        )
    return codes


def _is_numeric(kind: Any) -> bool:
    """A column that is empty throughout has the type null."""
    import pyarrow as pa

    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_null(kind))


def _as_integers(column: Any) -> IntArray:
    import pyarrow as pa

    values: IntArray = column.cast(pa.int64()).fill_null(MISSING).to_numpy(zero_copy_only=False)
    return values


def _as_floats(column: Any) -> FloatArray:
    import pyarrow as pa

    values: FloatArray = column.cast(pa.float64()).to_numpy(zero_copy_only=False)
    return values
