"""The Python API: the commands as functions, and their results as values.

The workflows are imported inside the functions, so that ``import scanloom`` and the command line's
``--help`` are quick.
"""

import shutil
import tempfile
import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.progress import Progress, silent
from fusion_core.model.recording import Recording
from fusion_core.model.rig import Mount

if TYPE_CHECKING:
    import pyarrow as pa

    from fusion_core.workflows.fuse.session import FuseOptions
    from fusion_core.workflows.map.options import MapOptions
    from fusion_core.workflows.scan_matching import ScanMatch
    from fusion_core.workflows.source import RoomChoice


@dataclass(frozen=True, kw_only=True)
class RecordingInfo:
    """What is inside a recording.

    ``duration_s`` is None where the format has no clock. ``topics``: a table with a row for each
    stream. ``can``: what can be done with the recording; ``warnings``: what cannot be read.
    ``document``: all that ``scanloom info --json`` prints.
    """

    format: str
    duration_s: float | None
    topics: "pa.Table"
    can: tuple[str, ...]
    warnings: tuple[str, ...]
    document: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class FuseResult:
    """What ``fuse`` found and wrote.

    ``mount``: the camera's pose on the LiDAR, each value with its standard deviation, None where it
    is not observable. ``frames``: a table with a row for each depth image. ``notes``: caveats of
    the results. ``alignment``: alignment.json.
    """

    folder: Path
    mount: Mount
    frames: "pa.Table"
    notes: tuple[str, ...]
    alignment: Mapping[str, Any]

    @cached_property
    def samples(self) -> "pa.Table":
        """A row for each beam in view of each frame: classes, confidences, raw and repaired."""
        from fusion_core.workflows.fuse.result_folder import read_samples

        return read_samples(self.folder)

    @cached_property
    def maps(self) -> dict[str, OccupancyGrid]:
        """The maps by name ("lidar", "camera", "fused"); none without recorded poses."""
        return _maps(self.folder)


@dataclass(frozen=True, kw_only=True)
class MapResult:
    """What ``build_map`` found and wrote.

    ``trajectory``: a table with a row for each scan, its stamp, the LiDAR's pose in the map, and
    whether it can be trusted. ``report``: report.json.
    """

    folder: Path
    trajectory: "pa.Table"
    report: Mapping[str, Any]

    @cached_property
    def maps(self) -> dict[str, OccupancyGrid]:
        """The maps by name, such as "lidar"."""
        return _maps(self.folder)

    def to_numpy(self) -> FloatArray:
        """(N, 3) the LiDAR's x, y, yaw in the map, in metres and radians, a row for each scan."""
        return np.column_stack([self.trajectory[name] for name in ("x_m", "y_m", "yaw_rad")])


_Result = TypeVar("_Result", FuseResult, MapResult)


def open(path: str | Path, room: "RoomChoice | None" = None) -> Recording:
    """Open a recording of any readable format, read-only.

    ``recording.topics`` lists its streams, ``recording.messages(topics)`` yields their decoded
    values in order, in metres, radians and nanoseconds. It closes at the end of a ``with`` block
    or by ``close()``. ``room`` chooses one of a Robot@Home data set. Raises ScanLoomError.
    """
    from fusion_core.workflows.source import open_source

    return open_source(Path(path), room)


def info(
    path: str | Path, room: "RoomChoice | None" = None, *, check: bool = False
) -> RecordingInfo:
    """What is inside a recording, and what can be done with it.

    This reads an index only; with ``check`` every message is read. Raises ScanLoomError.
    """
    import pyarrow as pa

    from fusion_core.workflows.info import info as describe

    document = describe(Path(path), room, check=check)
    return RecordingInfo(
        format=document["format"],
        duration_s=document["duration_s"],
        topics=pa.Table.from_pylist(document["topics"]),
        can=tuple(document["can"]),
        warnings=tuple(document["warnings"]),
        document=document,
    )


def fuse(
    recording: str | Path,
    output: str | Path | None = None,
    options: "FuseOptions | None" = None,
    progress: Progress = silent,
) -> FuseResult:
    """Align LiDAR and depth, classify the noise, repair both, and build the maps of a recording.

    ``output``: the folder for the results, which is not recomputed if it holds them already;
    without one they are deleted with the returned value. ``options``: a ``scanloom.FuseOptions``
    with the preset, the settings file, the topics and what else ``scanloom fuse`` takes.
    Raises ScanLoomError, AlignmentFailed where LiDAR and depth cannot be aligned.
    """
    from fusion_core.workflows.fuse.fuse import fuse as fuse_into
    from fusion_core.workflows.fuse.session import FuseOptions

    with _results_folder(output) as folder:
        fuse_into(Path(recording), folder, options or FuseOptions(), progress)
        return _delete_folder_with(_fuse_result(folder), output)


def build_map(
    recording: str | Path,
    output: str | Path | None = None,
    options: "MapOptions | None" = None,
    progress: Progress = silent,
) -> MapResult:
    """Estimate the LiDAR's trajectory and build a map, with loop closure.

    ``output`` as for ``fuse``. ``options``: a ``scanloom.MapOptions`` with the scans, the motion,
    the estimator and what else ``scanloom map`` takes. Raises ScanLoomError, MappingFailed where
    most scans cannot be trusted; the results are written to ``output`` nevertheless.
    """
    from fusion_core.workflows.map.build_map import build_map as build_into
    from fusion_core.workflows.map.options import MapOptions

    with _results_folder(output) as folder:
        build_into(Path(recording), folder, options or MapOptions(), progress)
        return _delete_folder_with(_map_result(folder), output)


def load(folder: str | Path) -> FuseResult | MapResult:
    """The results in a folder that ``scanloom fuse`` or ``scanloom map`` has written.

    Raises ScanLoomError where there are none, or where a file is not as it was written.
    """
    folder = Path(folder)
    if (folder / "alignment.json").is_file():
        return _fuse_result(folder)
    if (folder / "report.json").is_file():
        return _map_result(folder)
    raise ScanLoomError(
        "holds no results.",
        file=folder,
        advice="Give a folder that scanloom fuse or scanloom map has written.",
    )


def match_scans(
    first_ranges_m: FloatArray,
    second_ranges_m: FloatArray,
    *,
    angle_min_rad: float,
    angle_increment_rad: float,
    guess: FloatArray | None = None,
) -> "ScanMatch":
    """The pose of the second sweep of a 2D LiDAR in the frame of the first, by PL-ICP (Censi 2008).

    ``first_ranges_m``, ``second_ranges_m``: (N,) and (M,) metres; what is not finite and positive
    is a missing beam. Both have the given angles, counter-clockwise. ``guess``: (3,) x, y, yaw in
    metres and radians; none is needed. The result has the pose, its (3, 3) covariance, and whether
    the sweeps determine the motion in every direction (``is_observable``). Raises ScanLoomError
    where a sweep has too few beams or no start leads to a match.
    """
    from fusion_core.workflows import scan_matching

    return scan_matching.match_scans(
        first_ranges_m,
        second_ranges_m,
        angle_min_rad=angle_min_rad,
        angle_increment_rad=angle_increment_rad,
        guess=guess,
    )


@contextmanager
def _results_folder(output: str | Path | None) -> Iterator[Path]:
    """The folder ``output``, or without one a temporary folder, which a failure removes."""
    if output is not None:
        yield Path(output)
        return
    folder = Path(tempfile.mkdtemp(prefix="scanloom-"))
    try:
        yield folder
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _delete_folder_with(result: _Result, output: str | Path | None) -> _Result:
    """``result``, whose folder is deleted with it unless it is the named ``output``."""
    if output is None:
        weakref.finalize(result, shutil.rmtree, result.folder, ignore_errors=True)
    return result


def _fuse_result(folder: Path) -> FuseResult:
    from fusion_core.workflows.fuse.result_folder import read_fuse_folder

    found = read_fuse_folder(folder)
    return FuseResult(
        folder=folder,
        mount=found.mount,
        frames=found.frames,
        notes=found.notes,
        alignment=found.alignment,
    )


def _map_result(folder: Path) -> MapResult:
    import pyarrow as pa

    from fusion_core.workflows.map.result_folder import read_map_results

    found = read_map_results(folder)
    x_m, y_m, yaw_rad = found.trajectory.planar_poses.T
    trajectory = pa.table(
        {
            "stamp_ns": found.trajectory.stamps_ns,
            "x_m": x_m,
            "y_m": y_m,
            "yaw_rad": yaw_rad,
            "trusted": found.trusted,
        }
    )
    return MapResult(folder=folder, trajectory=trajectory, report=found.report)


def _maps(folder: Path) -> dict[str, OccupancyGrid]:
    from fusion_core.workflows.map.result_folder import read_maps

    return read_maps(folder)
