"""Each odometry of a map's folder against a reference: Li 2022, Table 5.

In a simulation the error of the wheels is a setting, not a result: the table names what was put in
above it, and the other rows are what the estimators make of that.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import JsonValue, TypeAdapter, ValidationError

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
_ERRORS = TypeAdapter(dict[str, dict[str, JsonValue]])
# Far above what any simulation states.
_MAX_ERRORS_BYTES = 1 << 20


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
    ``failed`` has the tracks that could not be compared, with the reason. ``put_in`` has the
    simulated errors by source, as the truth states them; null where it states none.

    Raises ScanLoomError where the folder holds no trajectory, the reference cannot be read, or no
    trajectory can be compared with it.
    """
    true, put_in = _read_reference(reference)
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
    return {
        "reference": str(reference),
        "put_in": put_in,
        "tracks": tracks,
        "failed": failed,
        "warnings": warnings,
    }


def odometry_lines(result: Mapping[str, Any]) -> list[str]:
    """The same for people: what was put in, then a line for each source, errors in percent."""
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
    lines = put_in_lines(result["put_in"])
    lines += [
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


def put_in_lines(put_in: Mapping[str, Mapping[str, Any]] | None) -> list[str]:
    """The simulated errors that act on odometry: those of the wheels, the standard deviations of
    the sensors, and the faults where there are any."""
    if put_in is None:
        return ["put in: not stated by the reference"]
    return [
        f"put in, {name}: "
        + ", ".join(
            f"{field} {_short(value)}"
            for field, value in values.items()
            if name in ("wheel", "faults") or "sigma" in field
        )
        for name, values in put_in.items()
    ]


def _short(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _trajectory_files(map_dir: Path) -> Iterator[tuple[str, Path]]:
    for file in sorted(map_dir.glob(f"{_PREFIX}*.tum")):
        yield file.stem.removeprefix(_PREFIX), file
    if (map_dir / _SLAM_TRAJECTORY).is_file():
        yield "trajectory", map_dir / _SLAM_TRAJECTORY


def _read_reference(file: Path) -> tuple[Trajectory, dict[str, dict[str, Any]] | None]:
    """The poses of a reference, and the simulated errors that it states."""
    if file.suffix != ".npz":
        try:
            return read_tum_trajectory(file).trajectory, None
        except OSError as error:
            raise ScanLoomError(f"cannot be read: {error.strerror}.", file=file) from error
    try:
        arrays = read_arrays(file, ("scan_stamp", "pose", "simulated_errors"))
        stamps_ns: IntArray = np.asarray(arrays["scan_stamp"])
        poses: FloatArray = np.asarray(arrays["pose"], dtype=np.float64)
        put_in = _stated_errors(arrays.get("simulated_errors"))
    except (OSError, KeyError, *UNREADABLE_ARRAYS) as error:
        raise ScanLoomError(
            f"cannot be read as a truth file: {error}.",
            file=file,
            advice="It must hold scan_stamp and pose; or give a TUM file.",
        ) from error
    try:
        return Trajectory.from_planar(stamps_ns.astype(np.int64), poses), put_in
    except ValueError as error:
        raise ScanLoomError(f"holds no poses of its scans: {error}.", file=file) from error


def _stated_errors(text: npt.NDArray[np.generic] | None) -> dict[str, dict[str, Any]] | None:
    """Raises ValueError where it is not JSON of names and values by source."""
    if text is None:
        return None
    if text.ndim != 0 or text.dtype.kind != "U" or text.nbytes > _MAX_ERRORS_BYTES:
        raise ValueError("simulated_errors is not a short text")
    try:
        return dict(_ERRORS.validate_json(str(text)))
    except ValidationError as error:
        raise ValueError("simulated_errors is not JSON of values by source") from error
