"""Sampling: the LiDAR curve to Psi samples, each depth row to W samples, left to right.

With intrinsics a sample is an angle: pixels become azimuths, depths along the optical axis become
horizontal ranges, and both curves have one sample a ``step_deg`` so that an offset u is an angle.
Without (and in the published preset) samples are taken by index, values as they come.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fusion_core.model.conventions import Float32Array, FloatArray, IntArray, read_only
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
    """

    beams: IntArray
    left_rad: float
    step_rad: float

    def __post_init__(self) -> None:
        read_only(self.beams)

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


def sample_curve(
    scan: LaserScan, settings: SamplingSettings, *, shift: float = 0.0
) -> CurveSampling:
    """The sampling of a LiDAR's curve (the paper's Psi: 240 of 682 beams).

    ``shift``: by which fraction of a sample every sample lies to the right (not by index).
    """
    beams = scan.ranges_m.size
    fov_rad = abs(scan.angle_increment_rad) * beams
    count = max(2, round(fov_rad / np.deg2rad(settings.step_deg)))
    order = np.arange(beams)[::-1] if scan.angle_increment_rad > 0.0 else np.arange(beams)
    azimuths_rad = scan.angles_rad[order]
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
    """The rig's yaw on the LiDAR for which row sample 0 falls on LiDAR sample ``u``."""
    return curve.left_rad - u * curve.step_rad - left_of_row_rad


def offset_of_yaw(yaw_rad: float, curve: CurveSampling, left_of_row_rad: float) -> float:
    """Inverse of :func:`yaw_of_offset_rad`."""
    return (curve.left_rad - yaw_rad - left_of_row_rad) / curve.step_rad
