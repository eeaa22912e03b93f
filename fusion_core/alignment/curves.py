"""Sampling: the LiDAR curve to Psi samples, each depth row to W samples, left to right.

With intrinsics a sample is an angle: pixels become azimuths, depths along the optical axis become
horizontal ranges, and both curves have one sample a ``step_deg`` so that an offset u is an angle.
Without (and in the published preset) samples are taken by index, values as they come.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fusion_core.model.conventions import Float32Array, FloatArray, IntArray, read_only
from fusion_core.model.polar import unwrap_towards
from fusion_core.model.rig import Camera
from fusion_core.model.sensors import LaserScan
from fusion_core.settings import StageSettings, setting


class SamplingSettings(StageSettings):
    """How LiDAR curve and depth rows become sequences of equal step."""

    by: Literal["angle", "index"] = setting(
        "angle", "Samples on equal angles, or every k-th beam and pixel as published"
    )
    # The field of a frame takes time with the square of the samples.
    step_deg: float = setting(1.0, "Angle of one sample", unit="deg", gt=0.05, le=5.0)
    assumed_fov_deg: float = setting(
        57.0,
        "Horizontal field of view where the camera has no intrinsics",
        unit="deg",
        gt=5,
        le=170,
    )
    row_first: int = setting(0, "First depth row that is searched", unit="row", ge=0, le=65_535)
    row_band: float = setting(
        1.0,
        "Fraction of the rows searched, counted from the bottom (published: half)",
        ge=1e-6,
        le=1.0,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveSampling:
    """Which beam gives which LiDAR sample. ``beams``: (Psi,) beam index, left to right.

    ``left_rad``: azimuth of sample 0 in the LiDAR frame; azimuth falls by ``step_rad`` a sample.
    ``turn_samples``: of a full circle, the samples of one turn; the curve then goes on beyond them
    by the width of a row, so that a row has W samples at every u of the turn. None where the curve
    has ends.
    """

    beams: IntArray
    left_rad: float
    step_rad: float
    turn_samples: float | None = None

    def __post_init__(self) -> None:
        read_only(self.beams)

    @property
    def samples(self) -> int:
        """Psi: how many samples there are, each direction once."""
        return self.beams.size if self.turn_samples is None else round(self.turn_samples)

    def difference(self, u: float, other_u: float) -> float:
        """``u`` - ``other_u``, around a full circle."""
        if self.turn_samples is None:
            return u - other_u
        return unwrap_towards(u - other_u, 0.0, self.turn_samples)

    def on_curve(self, u: float) -> float:
        """An offset of a full circle as it is counted: from half a sample before 0 on."""
        if self.turn_samples is None:
            return u
        return (u + 0.5) % self.turn_samples - 0.5

    def sample_of_azimuth(self, azimuth_rad: FloatArray) -> FloatArray:
        """Fractional sample index of azimuths in the LiDAR frame."""
        return (self.left_rad - azimuth_rad) / self.step_rad


@dataclass(frozen=True, slots=True, kw_only=True)
class RowSampling:
    """Which column gives which row sample. ``columns``: (W,) column index, left to right.

    ``left_rad``: azimuth of sample 0 in the rig frame; azimuth falls by ``step_rad`` a sample.
    ``range_per_depth``: (W,) horizontal range of a sample for 1 m along the optical axis.
    """

    columns: IntArray
    left_rad: float
    step_rad: float
    range_per_depth: FloatArray

    def __post_init__(self) -> None:
        read_only(self.columns)
        read_only(self.range_per_depth)

    def from_left_rad(self, azimuth_rad: FloatArray) -> FloatArray:
        """How far to the right of sample 0 azimuths in the rig frame lie, across the rig's back."""
        middle_rad = self.left_rad - 0.5 * (self.columns.size - 1) * self.step_rad
        return self.left_rad - unwrap_towards(azimuth_rad, middle_rad)


def sample_curve(
    scan: LaserScan, settings: SamplingSettings, *, shift: float = 0.0, width: int = 1
) -> CurveSampling:
    """The sampling of a LiDAR's curve (the paper's Psi: 240 of 682 beams).

    ``shift``: by which fraction of a sample every sample lies to the right (not by index).
    ``width``: the samples W of the rows that it is compared with, by which a full circle overlaps.
    """
    beams = scan.ranges_m.size
    fov_rad = abs(scan.angle_increment_rad) * beams
    count = max(2, round(fov_rad / np.deg2rad(settings.step_deg)))
    order = np.arange(beams)[::-1] if scan.angle_increment_rad > 0.0 else np.arange(beams)
    azimuths_rad = scan.angles_rad[order]
    if scan.is_full_circle:
        return _sample_circle(order, azimuths_rad, settings, count, shift=shift, width=width)
    if settings.by == "index":
        positions = np.linspace(0.0, beams - 1.0, count)
        step_rad = float((azimuths_rad[0] - azimuths_rad[-1]) / (count - 1))
        left_rad = float(azimuths_rad[0])
    else:
        step_rad = float(np.deg2rad(settings.step_deg))
        middle_rad = 0.5 * float(azimuths_rad[0] + azimuths_rad[-1])
        left_rad = middle_rad + (0.5 * (count - 1) - shift) * step_rad
        wanted_rad = left_rad - step_rad * np.arange(count)
        positions = (azimuths_rad[0] - wanted_rad) / abs(scan.angle_increment_rad)
    nearest = np.clip(np.rint(positions), 0, beams - 1).astype(np.int64)
    return CurveSampling(beams=order[nearest], left_rad=left_rad, step_rad=step_rad)


def _sample_circle(
    order: IntArray,
    azimuths_rad: FloatArray,
    settings: SamplingSettings,
    count: int,
    *,
    shift: float,
    width: int,
) -> CurveSampling:
    """A full circle's beams left to right, on beyond its seam. ``order``, ``azimuths_rad``: (N,)
    from the left; ``count`` samples make the circle."""
    beams = order.size
    beam_rad = float(azimuths_rad[0] - azimuths_rad[-1]) / (beams - 1)
    turn_beams = 2.0 * np.pi / beam_rad
    if settings.by == "index":
        step_rad, left_rad, turn = 2.0 * np.pi / count, float(azimuths_rad[0]), float(count)
        positions = turn_beams / count * np.arange(count + width - 1)
    else:
        step_rad = float(np.deg2rad(settings.step_deg))
        middle_rad = 0.5 * float(azimuths_rad[0] + azimuths_rad[-1])
        left_rad = middle_rad + (0.5 * (count - 1) - shift) * step_rad
        turn = 2.0 * np.pi / step_rad
        # A step that does not divide the turn: the last offset is less than a step from the first.
        offsets = int(np.ceil(turn - 1e-6))
        wanted_rad = left_rad - step_rad * np.arange(offsets + width - 1)
        positions = (azimuths_rad[0] - wanted_rad) / beam_rad
    nearest = np.rint(np.mod(positions, turn_beams)).astype(np.int64) % beams
    return CurveSampling(
        beams=order[nearest], left_rad=left_rad, step_rad=step_rad, turn_samples=turn
    )


def sample_row(camera: Camera, settings: SamplingSettings) -> RowSampling:
    """The sampling of one camera's rows (the paper's W)."""
    width = camera.intrinsics.width
    edges_rad = camera.column_azimuths_rad(np.array([-0.5, width - 0.5]))
    fov_rad = float(edges_rad[0] - edges_rad[1])
    count = max(2, int(fov_rad / np.deg2rad(settings.step_deg) + 0.25))
    if settings.by == "index":
        columns = np.linspace(0.0, width - 1.0, count)
        step_rad = fov_rad / count
        left_rad = float(edges_rad[0]) - 0.5 * step_rad
        range_per_depth = np.ones(count)
    else:
        step_rad = float(np.deg2rad(settings.step_deg))
        left_rad = 0.5 * float(edges_rad.sum()) + 0.5 * (count - 1) * step_rad
        azimuths_rad = left_rad - step_rad * np.arange(count)
        columns = camera.intrinsics.cx - camera.intrinsics.fx * np.tan(azimuths_rad)
        range_per_depth = 1.0 / np.cos(azimuths_rad)
    nearest = np.clip(np.rint(columns), 0, width - 1).astype(np.int64)
    return RowSampling(
        columns=nearest,
        left_rad=left_rad + camera.yaw_rad,
        step_rad=step_rad,
        range_per_depth=range_per_depth,
    )


def curve_samples_m(scan: LaserScan, sampling: CurveSampling) -> FloatArray:
    """(Psi,) ranges left to right, NaN where missing."""
    return scan.ranges_m[sampling.beams]


def row_samples_m(depth_m: Float32Array, sampling: RowSampling) -> FloatArray:
    """(H, W) horizontal ranges (by angle) or plain depths (by index), NaN where missing."""
    samples = depth_m[:, sampling.columns].astype(np.float64)
    samples *= sampling.range_per_depth
    return samples


def yaw_of_offset_rad(u: float, curve: CurveSampling, left_of_row_rad: float) -> float:
    """The rig's yaw on the LiDAR, within half a turn of 0, for which row sample 0 falls on LiDAR
    sample ``u``."""
    return float(unwrap_towards(curve.left_rad - u * curve.step_rad - left_of_row_rad, 0.0))


def offset_of_yaw(yaw_rad: float, curve: CurveSampling, row: RowSampling) -> float:
    """Inverse of :func:`yaw_of_offset_rad`: of the offsets whole turns apart, the one at which the
    row lies farthest within the curve."""
    u = (curve.left_rad - yaw_rad - row.left_rad) / curve.step_rad
    middle = 0.5 * (curve.beams.size - row.columns.size)
    return float(unwrap_towards(u, middle, 2.0 * np.pi / curve.step_rad))
