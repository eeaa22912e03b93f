"""Planes that a LiDAR on a turning axis sees twice: at an angle, and half a turn later.

A frame is what it measured while the axis was near one angle ψ, in its own coordinates: there its
mounting is a constant, and the two views of a frame differ by a rotation and a shift that are the
same for all frames. In the assembled cloud they would not be: the error turns with the axis.
The left view is taken at ψ, 0 to half a turn from the start; the right one at ψ + 180°, and is
rotated back by 180° about the axis (Song 2022, below (1)).
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.calibration.turning.planes import Plane, PlaneSettings, extract_planes
from fusion_core.calibration.turning.turn import Turn, rotate_about_z
from fusion_core.model.conventions import FloatArray, IntArray, read_only
from fusion_core.model.progress import Progress, silent
from fusion_core.settings import StageSettings, setting

_ROUND_ANGLE_RAD = 2e-3


class FrameSettings(StageSettings):
    """How a turn is cut into frames, and which planes of their two views are the same."""

    frames: int = setting(24, "Frames in half a turn", ge=4, le=360)
    groups: int = setting(6, "Groups of frames, for the repeatability (19)", ge=2, le=100)
    frame_deg: float = setting(6.0, "Turn of the axis during a frame", unit="deg", ge=0.1, le=60.0)
    frame_points: int = setting(6000, "Points used of a view", ge=100, le=1000000)
    match_deg: float = setting(
        20.0, "Greatest angle between the two views of a plane", unit="deg", ge=0.1, le=45.0
    )
    match_m: float = setting(
        0.3, "Greatest difference of their distances", unit="m", ge=1e-3, le=5.0
    )

    def center_rad(self, frame: int) -> float:
        """The axis angle of a frame's left view, from the start of the turn."""
        return np.pi * (frame + 0.5) / self.frames

    def frame_of(self, phase_rad: FloatArray) -> IntArray:
        """(N,) the frame nearest to angles from the start of the turn, in either half."""
        # An axis that stops does so near round angles, with a little noise to either side.
        shifted = phase_rad + _ROUND_ANGLE_RAD
        return np.floor(np.mod(shifted, np.pi) * self.frames / np.pi).astype(np.int64)


@dataclass(frozen=True, slots=True)
class PlanePair:
    """A plane in the left and in the right view of a frame.

    ``normal_left``, ``normal_right``: (3,) unit, ``offset_left_m``, ``offset_right_m``: distances
    from the two origins, N_L, N_R, α_L, α_R of Song. ``points_left_m``: (M, 3).
    """

    frame: int
    normal_left: FloatArray
    offset_left_m: float
    normal_right: FloatArray
    offset_right_m: float
    points_left_m: FloatArray

    def __post_init__(self) -> None:
        for array in (self.normal_left, self.normal_right, self.points_left_m):
            read_only(array)


def pair_planes(
    turn: Turn,
    frames: FrameSettings,
    planes: PlaneSettings,
    rng: np.random.Generator,
    progress: Progress = silent,
) -> tuple[PlanePair, ...]:
    """The planes that both views of a frame see, frame by frame."""
    nominal = turn.in_axis(np.zeros(4))
    phase = turn.axis_angles_rad - turn.axis_angles_rad.min()
    centers, half_width = _frame_centers(phase, turn.scan_indices, frames)
    pairs: list[PlanePair] = []
    for frame, center in centers.items():
        progress(frame, frames.frames, "planes of the half turns")
        views = [
            _view(nominal, phase, center + shift, half_width, frames.frame_points, rng)
            for shift in (0.0, np.pi)
        ]
        if min(len(view) for view in views) < planes.points_min:
            continue
        left, right = views[0], rotate_about_z(views[1], np.pi)
        found_left = extract_planes(left, planes, rng)
        found_right = extract_planes(right, planes, rng)
        for a, b in _match(found_left, found_right, frames):
            pairs.append(
                PlanePair(frame, a.normal, a.offset_m, b.normal, b.offset_m, left[a.members])
            )
    return tuple(pairs)


def _frame_centers(
    phase_rad: FloatArray, scan_indices: IntArray, settings: FrameSettings
) -> tuple[dict[int, float], float]:
    """The angle of each frame's left view and half the width of a view, in radians.

    An axis that stops for each scan has few angles: a frame is where a scan is, and so wide that
    each view has one.
    """
    _, scan = np.unique(scan_indices, return_inverse=True)
    scans_rad = np.sort(np.bincount(scan, phase_rad) / np.bincount(scan))
    step_rad = float(np.median(np.diff(scans_rad))) if scans_rad.size > 1 else 0.0
    centers: dict[int, float] = {}
    for frame in range(settings.frames):
        nearest = float(scans_rad[np.abs(scans_rad - settings.center_rad(frame)).argmin()])
        if nearest not in centers.values():
            centers[frame] = nearest
    return centers, max(0.5 * float(np.deg2rad(settings.frame_deg)), 0.51 * step_rad)


def _view(
    nominal_in_axis_m: FloatArray,
    phase_rad: FloatArray,
    center_rad: float,
    half_width_rad: float,
    points_max: int,
    rng: np.random.Generator,
) -> FloatArray:
    """(N, 3) points measured near one angle, as if all had been measured at it."""
    # Turns beyond the first repeat the views of the first one.
    away = np.remainder(phase_rad - center_rad + np.pi, 2.0 * np.pi) - np.pi
    chosen = np.flatnonzero(np.abs(away) <= half_width_rad)
    if chosen.size > points_max:
        chosen = rng.choice(chosen, points_max, replace=False)
    return rotate_about_z(nominal_in_axis_m[chosen], away[chosen])


def _match(
    left: tuple[Plane, ...], right: tuple[Plane, ...], settings: FrameSettings
) -> list[tuple[Plane, Plane]]:
    """Pairs that are each other's nearest in angle and distance."""
    if not left or not right:
        return []
    cos = np.stack([p.normal for p in left]) @ np.stack([p.normal for p in right]).T
    angle = np.arccos(np.clip(cos, -1.0, 1.0)) / np.deg2rad(settings.match_deg)
    offsets_left = np.array([p.offset_m for p in left])
    offsets_right = np.array([p.offset_m for p in right])
    apart = np.abs(offsets_left[:, np.newaxis] - offsets_right) / settings.match_m
    cost = np.where((angle < 1.0) & (apart < 1.0), angle + apart, np.inf)
    return [
        (left[a], right[b])
        for a, b in zip(range(len(left)), cost.argmin(axis=1).tolist(), strict=True)
        if np.isfinite(cost[a, b]) and cost[:, b].argmin() == a
    ]
