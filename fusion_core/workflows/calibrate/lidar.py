"""Self-calibration of a LiDAR on a turning axis (Song 2022, §2.1), from a recording to a file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.calibration.turning.self_calibration import SelfCalibration, self_calibrate
from fusion_core.calibration.turning.turn import SELF_CALIBRATION_PARAMETERS, Turn, rotate_about_z
from fusion_core.calibration.turning.turn_axis import axis_aligned_mountings, occupied_voxels
from fusion_core.exporting.clouds import require_cloud_suffix, write_cloud
from fusion_core.exporting.extrinsics_files import require_result_suffix, write_document
from fusion_core.files.atomic import require_folder_of
from fusion_core.files.inputs import require_apart
from fusion_core.model.conventions import Float32Array, FloatArray
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.geometry import transform_points
from fusion_core.model.progress import Progress
from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.calibrate.lidar_settings import LidarSettings, lidar_settings
from fusion_core.workflows.calibrate.turn_recording import TurnRecording
from fusion_core.workflows.fuse.settings import PresetName
from fusion_core.workflows.source import input_files

# Points that are kept of a turn for the estimate are drawn again from twice as many.
_READ_FACTOR = 2
# Readers of cloud files take no more than 2^23 points.
_CLOUD_POINTS_MAX = 8_000_000
_AXIS_TRIAL_POINTS = 40_000
# How much fuller the voxels of the recorded mounting may be than those of the sharpest one.
_BLUR_MAX = 1.15
_ANGLE_BETWEEN_SCANS_MAX_RAD = float(np.deg2rad(60.0))


@dataclass(frozen=True, kw_only=True)
class LidarOptions:
    """``points``, ``joint``: topic of the clouds and name of the axis, None to find them.
    ``cloud``: where to write the dense cloud (.ply or .pcd), None not to."""

    preset: PresetName = "default"
    settings_file: Path | None = None
    seed: int | None = None
    points: str | None = None
    joint: str | None = None
    cloud: Path | None = None


def calibrate_lidar(
    path: Path, output: Path, options: LidarOptions, progress: Progress
) -> dict[str, Any]:
    """Estimate θ, β, Δx, Δy of the LiDAR in the recording at ``path``, and write ``output`` (.json
    or .toml) and the cloud. The result is what the file holds, ready for JSON.

    Raises ScanLoomError for what cannot be read, estimated or written.
    """
    preset, settings = lidar_settings(options.preset, options.settings_file, options.seed)
    require_result_suffix(output)
    with open_recording(path) as recording:
        inputs = [*input_files(recording)]
        if options.settings_file is not None:
            inputs.append(options.settings_file)
        for target in (output, options.cloud):
            if target is not None:
                require_folder_of(target)
                require_apart(target, inputs)
        if options.cloud is not None:
            require_cloud_suffix(options.cloud)
        try:
            source = TurnRecording(recording, options.points, options.joint)
            turn, result, notes = calibrate_turn(source, settings, progress)
        except CalibrationFailed as error:
            if error.file is not None:
                raise
            raise CalibrationFailed(error.problem, file=path, advice=error.advice) from error
        if options.cloud is not None:
            notes += _write_cloud(source, result.T_axis_lidar, options.cloud, settings, progress)
        notes += [warning for warning in recording.warnings if warning not in notes]
    document = {
        "preset": preset,
        "axis": source.axis.source,
        "points_topic": source.topic,
        "lidar_frame": source.frame,
        **_document(result, turn),
        "notes": notes,
    }
    write_document(output, document)
    return document


def calibrate_turn(
    source: TurnRecording, settings: LidarSettings, progress: Progress
) -> tuple[Turn, SelfCalibration, list[str]]:
    """The points that are read of a recorded turn, its self-calibration, and what is to be said
    about both. Whether points without instants are spread over their scans is left as it fits best.

    Raises CalibrationFailed.
    """
    fits: dict[bool, tuple[Turn, SelfCalibration, list[str]]] = {}
    failure: CalibrationFailed | None = None
    for source.spread_points in (False, True):
        try:
            fits[source.spread_points] = _estimate(source, settings, progress)
        except CalibrationFailed as error:
            # Points at wrong instants blur the planes, so much that none may be found.
            failure = failure or error
        if not source.lacks_instants:
            break
    if not fits:
        assert failure is not None
        raise failure
    source.spread_points = min(fits, key=lambda spread: fits[spread][1].sigma_m)
    return fits[source.spread_points]


def lidar_lines(document: dict[str, Any]) -> list[str]:
    """The result for people."""
    units = {"theta": ("deg", 180.0 / np.pi), "beta": ("deg", 180.0 / np.pi)}
    lines = []
    for name, symbol in zip(SELF_CALIBRATION_PARAMETERS, ("θ", "β", "Δx", "Δy"), strict=True):
        unit, scale = units.get(name.split("_")[0], ("mm", 1000.0))
        value, sd = document[name] * scale, document["sd"][name] * scale
        lines.append(f"{symbol:<10}{value:9.4f} ± {sd:.4f} {unit}")
    if document["E_r_deg"] is not None:
        lines.append(
            f"{'E_r, E_t':<10}{document['E_r_deg']:.4f} deg, {1e3 * document['E_t_m']:.3f} mm "
            f"over {len(document['groups'])} groups (19)"
        )
    lines.append(
        f"{'halves':<10}{1e3 * document['mismatch_before_m']:.1f} mm apart before, "
        f"{1e3 * document['mismatch_after_m']:.1f} mm after"
    )
    for plane in document["planes"]:
        shares = " ".join(
            f"{symbol} {100.0 * share:.0f} %"
            for symbol, share in zip(("θ", "β", "Δx", "Δy"), plane["shares"].values(), strict=True)
        )
        lines.append(f"{'plane':<10}{plane['name']:<28} {shares}")
    return lines + [f"{'note':<10}{note}" for note in document["notes"]]


def _estimate(
    source: TurnRecording, settings: LidarSettings, progress: Progress
) -> tuple[Turn, SelfCalibration, list[str]]:
    """The turn, the estimate, and what is to be said about both."""
    turn = _read_turn(source, settings, progress)
    notes = [*source.notes, *source.reading_notes()]
    turn, mounting_notes = _with_mounting(turn, source.axis.T_axis_lidar)
    result = self_calibrate(
        turn, settings.self_calibration, settings.frames, settings.planes, progress
    )
    return turn, result, [*notes, *mounting_notes, *result.notes]


def _read_turn(source: TurnRecording, settings: LidarSettings, progress: Progress) -> Turn:
    """A random part of the points of each cloud: with every k-th one some rings might be lost."""
    rng = np.random.default_rng(settings.self_calibration.seed)
    wanted = _READ_FACTOR * settings.self_calibration.points_max
    kept_of_each = max(1, -(-wanted // max(source.count, 1)))
    points, angles, scans, middles = [], [], [], []
    for index, scan in enumerate(source.scans()):
        progress(index, source.count, "reading")
        chosen = np.arange(len(scan.xyz_m))
        if chosen.size > kept_of_each:
            chosen = np.sort(rng.choice(chosen, kept_of_each, replace=False))
        points.append(scan.xyz_m[chosen].astype(np.float64))
        angles.append(scan.axis_angles_rad[chosen])
        scans.append(np.full(chosen.size, index))
        if chosen.size:
            middles.append(float(np.median(scan.axis_angles_rad)))
    if not middles:
        why = "; ".join(source.reading_notes()) or "its clouds are empty"
        raise CalibrationFailed(
            f"no point of {source.topic} has a position and an axis angle: {why}.",
            advice="Record the clouds and the axis at the same time, by one clock.",
        )
    steps = np.abs(np.diff(middles))
    if steps.size and np.median(steps) > _ANGLE_BETWEEN_SCANS_MAX_RAD:
        raise CalibrationFailed(
            f"the axis turns by {np.median(steps):.1f} rad between two clouds.",
            advice="Give its angles in radians, as JointState has them.",
        )
    return Turn(
        points_in_lidar_m=np.concatenate(points),
        axis_angles_rad=np.concatenate(angles),
        scan_indices=np.concatenate(scans),
        T_axis_lidar_nominal=np.eye(4),
    )


def _with_mounting(turn: Turn, recorded: FloatArray | None) -> tuple[Turn, list[str]]:
    """The turn with the recorded mounting, or with the one that gives the sharpest cloud where
    there is none or where it gives a blurred one; and what is to be said about it."""
    rng = np.random.default_rng(0)
    count = len(turn.points_in_lidar_m)
    part = turn.subset(rng.choice(count, min(count, _AXIS_TRIAL_POINTS), replace=False))
    mountings = axis_aligned_mountings()
    voxels = {
        name: occupied_voxels(part.points_in_lidar_m, part.axis_angles_rad, T)
        for name, T in mountings.items()
    }
    best = min(voxels, key=lambda name: voxels[name])
    found = f"the axis is taken to lie along the LiDAR's {best}, where the cloud is sharpest"
    if recorded is None:
        return _mounted(turn, mountings[best]), [f"no transform tells how it is mounted: {found}"]
    own = occupied_voxels(part.points_in_lidar_m, part.axis_angles_rad, recorded)
    if own <= _BLUR_MAX * voxels[best]:
        return _mounted(turn, recorded), []
    return _mounted(turn, mountings[best]), [f"the recorded mounting blurs the cloud: {found}"]


def _mounted(turn: Turn, T_axis_lidar_nominal: FloatArray) -> Turn:
    return Turn(
        points_in_lidar_m=turn.points_in_lidar_m,
        axis_angles_rad=turn.axis_angles_rad,
        scan_indices=turn.scan_indices,
        T_axis_lidar_nominal=T_axis_lidar_nominal,
    )


def _write_cloud(
    source: TurnRecording,
    T_axis_lidar: FloatArray,
    path: Path,
    settings: LidarSettings,
    progress: Progress,
) -> list[str]:
    """Write the dense cloud of the turn in ``rig``; what was left out of it is to be noted."""
    points_m, intensity, notes = dense_cloud(source, T_axis_lidar, settings, progress)
    write_cloud(path, points_m.astype(np.float64), intensity=intensity)
    return [f"{path.name}: {note}" for note in notes]


def dense_cloud(
    source: TurnRecording, T_axis_lidar: FloatArray, settings: LidarSettings, progress: Progress
) -> tuple[Float32Array, Float32Array | None, list[str]]:
    """(N, 3) points of a turn in ``rig``, their (N,) intensities where all clouds have them, and
    what was left out."""
    rng = np.random.default_rng(settings.self_calibration.seed)
    kept_of_each = max(1, _CLOUD_POINTS_MAX // max(source.count, 1))
    parts, intensities, thinned = [], [], False
    for index, scan in enumerate(source.scans()):
        progress(index, source.count, "dense cloud")
        chosen = np.arange(len(scan.xyz_m))
        if chosen.size > kept_of_each:
            chosen, thinned = np.sort(rng.choice(chosen, kept_of_each, replace=False)), True
        in_axis = transform_points(T_axis_lidar, scan.xyz_m[chosen].astype(np.float64))
        parts.append(rotate_about_z(in_axis, scan.axis_angles_rad[chosen]).astype(np.float32))
        if scan.intensity is not None:
            intensities.append(scan.intensity[chosen])
    intensity = np.concatenate(intensities) if len(intensities) == len(parts) else None
    notes = [f"{kept_of_each} points of each cloud are taken at most"] if thinned else []
    return np.concatenate(parts), intensity, notes


def _document(result: SelfCalibration, turn: Turn) -> dict[str, Any]:
    names = SELF_CALIBRATION_PARAMETERS
    return {
        "method": result.method,
        **dict(zip(names, result.parameters.tolist(), strict=True)),
        "sd": dict(zip(names, result.sd.tolist(), strict=True)),
        "parameters": list(names),
        "covariance": result.covariance.tolist(),
        "T_axis_lidar": result.T_axis_lidar.tolist(),
        "T_axis_lidar_nominal": turn.T_axis_lidar_nominal.tolist(),
        "E_r_deg": float(np.rad2deg(result.E_r_rad)) if len(result.groups) > 1 else None,
        "E_t_m": result.E_t_m if len(result.groups) > 1 else None,
        "groups": result.groups.tolist(),
        "sigma_m": result.sigma_m,
        "mismatch_before_m": result.mismatch_before_m,
        "mismatch_after_m": result.mismatch_after_m,
        "points": result.points,
        "turn_deg": float(np.rad2deg(np.ptp(turn.axis_angles_rad))),
        "planes": [
            {
                "name": plane.name,
                "normal": plane.normal.tolist(),
                "offset_m": plane.offset_m,
                "points_left": plane.points_left,
                "points_right": plane.points_right,
                "sigma_m": plane.sigma_m,
                "shares": dict(zip(names, plane.shares.tolist(), strict=True)),
            }
            for plane in result.planes
        ],
    }
