"""Self-calibration of a LiDAR on a turning axis (Song 2022, §2.1).

``published``: planes of frames half a turn apart, Procrustes (6), offset (4), Levenberg-Marquardt
on (7) over rotation and shift, whose halves are the mounting error. ``default`` starts from that
and estimates the mounting and the planes together from the points of the whole turn.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fusion_core.calibration.turning.half_turn_planes import FrameSettings, PlanePair, pair_planes
from fusion_core.calibration.turning.plane_procrustes import half_turn_pose, mounting_from_half_turn
from fusion_core.calibration.turning.planes import PlaneSettings
from fusion_core.calibration.turning.turn import SELF_CALIBRATION_PARAMETERS, Turn, rotate_about_z
from fusion_core.calibration.turning.whole_turn import SeenPlane, WholeTurn, plane_name
from fusion_core.model.conventions import FloatArray, read_only
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.progress import Progress, silent
from fusion_core.model.seeds import SEED_MAX
from fusion_core.settings import StageSettings, setting

# An estimate whose own standard deviation is above this is none: mountings are better than that.
_TILT_SD_MAX_RAD = float(np.deg2rad(0.5))
_OFFSET_SD_MAX_M = 0.05
_STANDS_STILL_RAD = float(np.deg2rad(1.0))
# No LiDAR's points in a place with planes lie so far away.
_RANGE_MEDIAN_MAX_M = 300.0
_PARALLEL_RAD = float(np.deg2rad(15.0))
_PAIRS_MIN = 3
# Of fewer estimates the scatter is a guess.
_GROUPS_MIN = 4
# What noise alone leaves is a seventh of it, with some thousand points of a plane.
_MISMATCH_SIGMAS = 0.5
_MISMATCH_MIN_M = 0.003
_ABOUT_AXIS_MAX_RAD = float(np.deg2rad(0.5))
# Of what planes in all directions would say.
_WEAK = 0.01
_NAMES = dict(zip(SELF_CALIBRATION_PARAMETERS, ("θ", "β", "Δx", "Δy"), strict=True))


class SelfCalibrationSettings(StageSettings):
    """How the mounting of the LiDAR on its axis is estimated."""

    method: Literal["bundle", "half_turns"] = setting(
        "bundle", "Mounting and planes together, or (2) to (7) between half turns"
    )
    points_max: int = setting(500000, "Points used of a turn", ge=10000, le=10000000)
    overlap_min_deg: float = setting(
        30.0, "Least turn of the axis beyond 180", unit="deg", ge=1.0, le=180.0
    )
    seed: int = setting(0, "Decides which points are used", ge=0, le=SEED_MAX)


@dataclass(frozen=True, slots=True, kw_only=True)
class SelfCalibration:
    """θ, β, Δx, Δy of a LiDAR on a turning axis.

    ``parameters``: (4,) in the order of SELF_CALIBRATION_PARAMETERS. ``covariance``: (4, 4).
    ``T_axis_lidar``: (4, 4) the mounting with them. ``groups``: (G, 4) estimates from parts of the
    turn alone, none where those do not determine them. ``planes``: those in ``rig``. ``sigma_m``:
    median scatter of the points about them. ``mismatch_before_m``, ``mismatch_after_m``: root mean
    square over the planes of the distance between what the two half turns see of each.
    """

    parameters: FloatArray
    covariance: FloatArray
    T_axis_lidar: FloatArray
    groups: FloatArray
    planes: tuple[SeenPlane, ...]
    sigma_m: float
    mismatch_before_m: float
    mismatch_after_m: float
    method: str
    points: int
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for array in (self.parameters, self.covariance, self.T_axis_lidar, self.groups):
            read_only(array)

    @property
    def sd(self) -> FloatArray:
        """(4,) standard deviations."""
        deviations: FloatArray = np.sqrt(np.diag(self.covariance))
        return deviations

    @property
    def E_r_rad(self) -> float:
        """Scatter of θ and β over the groups, (19); NaN with fewer than two."""
        return _scatter(self.groups[:, :2])

    @property
    def E_t_m(self) -> float:
        """Scatter of Δx and Δy over the groups, (19); NaN with fewer than two."""
        return _scatter(self.groups[:, 2:])


def self_calibrate(
    turn: Turn,
    settings: SelfCalibrationSettings,
    frames: FrameSettings,
    planes: PlaneSettings,
    progress: Progress = silent,
) -> SelfCalibration:
    """Estimate the mounting error of the LiDAR of a turn.

    Raises CalibrationFailed where the turn or its planes do not determine it.
    """
    _require_usable(turn, settings)
    rng = np.random.default_rng(settings.seed)
    if len(turn.points_in_lidar_m) > settings.points_max:
        count = len(turn.points_in_lidar_m)
        turn = turn.subset(np.sort(rng.choice(count, settings.points_max, replace=False)))
    pairs = pair_planes(turn, frames, planes, rng, progress)
    _require_pairs(pairs, turn, frames)
    lidar_in_axis_m = turn.T_axis_lidar_nominal[:3, 3]
    start, about_axis_rad = _from_half_turns(pairs, lidar_in_axis_m)
    whole = WholeTurn(turn, start, planes, rng, progress)
    notes: list[str] = []
    if abs(about_axis_rad) > _ABOUT_AXIS_MAX_RAD:
        notes.append(
            f"the half turns are {np.rad2deg(about_axis_rad):.2f} deg apart about the axis, which "
            "no mounting explains: check the axis angles and the instants of the points"
        )
    if settings.method == "half_turns":
        parameters = start
        groups = _half_turn_groups(pairs, frames.groups, lidar_in_axis_m)
        # (7) takes the planes of the right views as known, so its residuals tell too little. Six
        # groups tell the scatter of each parameter, and nothing of their correlation.
        covariance = np.diag(groups.var(axis=0, ddof=1)) / len(groups)
    else:
        parameters, covariance = whole.solution.parameters, whole.solution.covariance
        groups = whole.groups(frames)
        if len(groups) < 2:
            notes.append("too few frames see enough planes to repeat the estimate (19)")
        if not whole.solution.converged:
            notes.append("the estimate has not converged")
    mismatch_m = whole.mismatch_m(parameters)
    if mismatch_m > max(_MISMATCH_SIGMAS * whole.median_sigma_m, _MISMATCH_MIN_M):
        notes.append(
            f"the half turns still see planes {1e3 * mismatch_m:.0f} mm apart: something else than "
            "the mounting is wrong, such as the instants of the points, and the deviations stated "
            "are too small"
        )
    _require_determined(covariance)
    return SelfCalibration(
        parameters=parameters,
        covariance=covariance,
        T_axis_lidar=turn.mounting(parameters),
        groups=groups,
        planes=whole.seen_planes(),
        sigma_m=whole.median_sigma_m,
        mismatch_before_m=whole.mismatch_m(np.zeros(4)),
        mismatch_after_m=mismatch_m,
        method=settings.method,
        points=len(turn.points_in_lidar_m),
        notes=tuple(notes),
    )


def _require_usable(turn: Turn, settings: SelfCalibrationSettings) -> None:
    if len(turn.points_in_lidar_m) == 0:
        raise CalibrationFailed("no point of the turn has a position and an axis angle.")
    median_m = float(np.median(np.linalg.norm(turn.points_in_lidar_m, axis=1)))
    if median_m > _RANGE_MEDIAN_MAX_M:
        raise CalibrationFailed(
            f"the points are {median_m:.0f} m away (median): these are not metres.",
            advice="Give x, y and z in metres; a driver may have written millimetres.",
        )
    extent_rad = float(np.ptp(turn.axis_angles_rad))
    if extent_rad < _STANDS_STILL_RAD:
        raise CalibrationFailed(
            f"the axis stands still: it turns by {np.rad2deg(extent_rad):.2f} deg.",
            advice="Record while it turns through 360 degrees, and name its joint.",
        )
    least_deg = 180.0 + settings.overlap_min_deg
    if np.rad2deg(extent_rad) < least_deg:
        raise CalibrationFailed(
            f"the axis turns through {np.rad2deg(extent_rad):.0f} deg: too little is seen twice, "
            "half a turn apart.",
            advice=f"Turn it through 360 degrees, at least through {least_deg:.0f}.",
        )


def _require_pairs(pairs: tuple[PlanePair, ...], turn: Turn, frames: FrameSettings) -> None:
    advice = "Scan where two walls or more and floor or ceiling are in view of both half turns."
    if len(pairs) < _PAIRS_MIN:
        raise CalibrationFailed(
            f"{len(pairs)} planes are seen by both half turns, and {_PAIRS_MIN} are needed.",
            advice=advice,
        )
    normals = np.stack([pair.normal_right for pair in pairs])
    start_rad = float(turn.axis_angles_rad.min())
    angles_rad = np.array([start_rad + frames.center_rad(pair.frame) for pair in pairs])
    in_rig = rotate_about_z(normals, angles_rad)
    if _all_parallel(in_rig):
        names = {plane_name(n, p.offset_right_m) for n, p in zip(in_rig, pairs, strict=True)}
        raise CalibrationFailed(
            f"all planes that both half turns see are parallel ({', '.join(sorted(names)[:4])}).",
            advice=advice,
        )
    weak = _weak_parameters(normals)
    if weak:
        raise CalibrationFailed(
            f"the planes do not determine {', '.join(weak)}: none faces that way.", advice=advice
        )


def _all_parallel(normals: FloatArray) -> bool:
    """Whether no two of (P, 3) unit normals are more than 15 degrees apart, up to their sign."""
    smallest = np.abs(normals @ normals.T).min()
    return bool(smallest > np.cos(_PARALLEL_RAD))


def _weak_parameters(normals: FloatArray) -> list[str]:
    """Names of what planes with (P, 3) normals, in ``axis``, leave open in (4) and (6)."""
    spread = normals.T @ normals / len(normals)
    names = []
    # A rotation about a normal does not change it: two directions are needed.
    if np.linalg.eigvalsh(spread)[1] < _WEAK:
        names += ["θ", "β"]
    values, vectors = np.linalg.eigh(spread[:2, :2])
    for value, vector in zip(values, vectors.T, strict=True):
        if value < _WEAK:
            names.append("Δx" if abs(vector[0]) > abs(vector[1]) else "Δy")
    return names


def _require_determined(covariance: FloatArray) -> None:
    limits = np.array([_TILT_SD_MAX_RAD] * 2 + [_OFFSET_SD_MAX_M] * 2)
    deviations = np.sqrt(np.diag(covariance))
    # A comparison with NaN is false.
    weak = [
        name
        for name, fine in zip(SELF_CALIBRATION_PARAMETERS, deviations < limits, strict=True)
        if not fine
    ]
    if weak:
        raise CalibrationFailed(
            f"the planes do not determine {', '.join(_NAMES[name] for name in weak)}.",
            advice="Scan where more walls are in view of both half turns.",
        )


def _from_half_turns(
    pairs: tuple[PlanePair, ...], lidar_in_axis_m: FloatArray
) -> tuple[FloatArray, float]:
    """(4,) parameters of (2) to (7), and the angle about the axis that is left over."""
    rotation, offset_m, _ = half_turn_pose(pairs)
    return mounting_from_half_turn(rotation, offset_m, lidar_in_axis_m)


def _half_turn_groups(
    pairs: tuple[PlanePair, ...], count: int, lidar_in_axis_m: FloatArray
) -> FloatArray:
    """(G, 4) the same from every count-th frame alone, without groups of too few planes."""
    # Of the frames that there are: an axis that stops for each scan leaves some out.
    _, frame_of = np.unique([pair.frame for pair in pairs], return_inverse=True)
    groups = []
    for group in range(count):
        own = tuple(p for p, frame in zip(pairs, frame_of, strict=True) if frame % count == group)
        if len(own) >= _PAIRS_MIN and not _weak_parameters(
            np.stack([pair.normal_right for pair in own])
        ):
            groups.append(_from_half_turns(own, lidar_in_axis_m)[0])
    if len(groups) < _GROUPS_MIN:
        raise CalibrationFailed(
            "too few frames have enough planes to repeat the estimate.",
            advice="Turn the axis through 360 degrees, where walls, floor and ceiling are in view.",
        )
    return np.stack(groups)


def _scatter(values: FloatArray) -> float:
    if len(values) < 2:
        return float("nan")
    return float(np.sqrt(np.square(values - values.mean(axis=0)).sum(axis=1).mean()))
