"""Each odometry of a map's folder against a reference: Li 2022, Table 5."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.evaluation.odometry import SEGMENT_M, evaluate_odometry
from fusion_core.evaluation.trajectories import MAX_GAP_S
from fusion_core.evaluation.truth_arrays import UNREADABLE_ARRAYS, read_arrays
from fusion_core.exporting.manifest import require_intact
from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.trajectory import Trajectory
from fusion_core.recordings.tum_trajectory import read_tum_trajectory

_PREFIX = "odometry_"
_SLAM_TRAJECTORY = "trajectory.tum"


def odometry(
    map_dir: Path,
    reference: Path,
    *,
    segment_m: float = SEGMENT_M,
    max_gap_s: float = MAX_GAP_S,
) -> dict[str, Any]:
    """Drift of every ``odometry_NAME.tum`` of a folder, and of its trajectory.tum.

    ``reference``: a TUM file, or a truth (.npz) with ``scan_stamp`` in ns and ``pose``, x, y, yaw
    of the LiDAR. A file holds only measured poses: a track of few ``poses`` was lost for long.
    ``failed`` has the tracks that could not be compared, with the reason.

    Raises ScanLoomError where the folder holds no trajectory, the reference cannot be read, or no
    trajectory can be compared with it.
    """
    true = _read_reference(reference)
    warnings: list[str] = []
    tracks: dict[str, Any] = {}
    failed: dict[str, str] = {}
    files = list(_trajectory_files(map_dir))
    require_intact(map_dir, [file.name for _, file in files], "map")
    for name, file in files:
        own = read_tum_trajectory(file)
        warnings += own.warnings
        try:
            report = evaluate_odometry(
                own.trajectory, true, segment_m=segment_m, max_gap_s=max_gap_s
            )
        except ScanLoomError as error:
            failed[name] = str(error)
            continue
        tracks[name] = {"poses": int(own.trajectory.stamps_ns.size), **report.to_json()}
    if not tracks and not failed:
        raise ScanLoomError(
            "holds no odometry and no trajectory.",
            file=map_dir,
            advice="Give a folder that scanloom map has written.",
        )
    if not tracks:
        raise ScanLoomError(next(iter(failed.values())), file=map_dir)
    return {"reference": str(reference), "tracks": tracks, "failed": failed, "warnings": warnings}


def odometry_lines(result: Mapping[str, Any]) -> list[str]:
    """The same for people: a line for each source, errors in percent of the path."""
    rows = [("", "Table 5 (%)", "length (%)", "at end (%)", "mean (%)", "mean (deg/m)")]
    for name, report in result["tracks"].items():
        straight = report["straight"]["error"]
        rows.append(
            (
                name,
                "-" if straight is None else f"{100.0 * straight:.2f}",
                f"{100.0 * report['distance_error']:.2f}",
                f"{100.0 * report['end']['translation_error']:.2f}",
                f"{100.0 * report['over_stretches']['translation_error']:.2f}",
                f"{report['over_stretches']['rotation_deg_per_m']:.3f}",
            )
        )
    first = next(iter(result["tracks"].values()))
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = [
        "  ".join(
            [row[0].ljust(widths[0])]
            + [value.rjust(width) for value, width in zip(row[1:], widths[1:], strict=True)]
        )
        for row in rows
    ]
    lines.append(
        f"{first['path_m']:.2f} m path, {first['straight']['stretches']} straight segments of "
        f"{sum(first['straight']['true_m']):.2f} m, mean over segments of {first['stretch_m']:g} m"
    )
    lines += [f"{name}: {problem}" for name, problem in result["failed"].items()]
    return lines + [f"warning: {warning}" for warning in result["warnings"]]


def _trajectory_files(map_dir: Path) -> Iterator[tuple[str, Path]]:
    for file in sorted(map_dir.glob(f"{_PREFIX}*.tum")):
        yield file.stem.removeprefix(_PREFIX), file
    if (map_dir / _SLAM_TRAJECTORY).is_file():
        yield "trajectory", map_dir / _SLAM_TRAJECTORY


def _read_reference(file: Path) -> Trajectory:
    if file.suffix != ".npz":
        try:
            return read_tum_trajectory(file).trajectory
        except OSError as error:
            raise ScanLoomError(f"cannot be read: {error.strerror}.", file=file) from error
    try:
        arrays = read_arrays(file, ("scan_stamp", "pose"))
        stamps_ns: IntArray = np.asarray(arrays["scan_stamp"])
        poses: FloatArray = np.asarray(arrays["pose"], dtype=np.float64)
    except (OSError, KeyError, *UNREADABLE_ARRAYS) as error:
        raise ScanLoomError(
            f"cannot be read as a truth file: {error}.",
            file=file,
            advice="It must hold scan_stamp and pose; or give a TUM file.",
        ) from error
    try:
        return Trajectory.from_planar(stamps_ns.astype(np.int64), poses)
    except ValueError as error:
        raise ScanLoomError(f"holds no poses of its scans: {error}.", file=file) from error
