"""A spinning LiDAR of 16 rings: the directions and instants of its beams, and its intensities."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray, read_only
from fusion_core.settings import StageSettings, setting

RINGS = 16
RING_SPACING_RAD = np.deg2rad(2.0)
# VLP-16 manual: the lasers fire one by one, 2.304 µs apart, and the column repeats after 55.296 µs.
_FIRING_S = 2.304e-6
# The largest value of a diffuse reflector is 100, above are retroreflectors.
_DIFFUSE_FULL_SCALE = 100.0
_INTENSITY_MAX = 255.0


class SpinningLidarSettings(StageSettings):
    """A VLP-16 by its data sheet, and how its returns depend on what they hit."""

    rotation_hz: float = setting(10.0, "Scans a second", unit="Hz", ge=5.0, le=20.0)
    columns: int = setting(1800, "Directions of the beams of a ring in a scan", ge=16, le=9000)
    range_sigma_m: float = setting(
        0.01,
        "Standard deviation of a range; the data sheet states ±30 mm",
        unit="m",
        ge=0.0,
        le=0.5,
    )
    range_quantum_m: float = setting(0.002, "Resolution of a range", unit="m", ge=0.0, le=0.1)
    beam_footprint_m: float = setting(
        0.012, "Diameter of a beam on a surface", unit="m", ge=0.0, le=0.2
    )
    range_exponent: float = setting(
        1.0, "Intensity falls with this power of the range", ge=0.0, le=4.0
    )
    reference_range_m: float = setting(
        2.5,
        "Range at which a white surface, head on, has intensity 100",
        unit="m",
        ge=0.1,
        le=100.0,
    )
    incidence_exponent: float = setting(
        1.0, "Intensity falls with this power of the cosine of incidence", ge=0.0, le=4.0
    )
    intensity_noise: float = setting(0.03, "Relative noise of an intensity", ge=0.0, le=1.0)


@dataclass(frozen=True, slots=True)
class BeamPattern:
    """The beams of one scan in the order in which they fire.

    ``directions``: (N, 3) unit, in the LiDAR's frame: z is its spin axis, azimuth 0 is x, and
    azimuths rise anticlockwise. ``rings``: (N,) uint8, 0 is the lowest. ``offsets_s``: (N,) since
    the scan's stamp.
    """

    directions: FloatArray
    rings: ByteArray
    offsets_s: FloatArray

    def __post_init__(self) -> None:
        for array in (self.directions, self.rings, self.offsets_s):
            read_only(array)


def beam_pattern(settings: SpinningLidarSettings) -> BeamPattern:
    """One rotation, column by column."""
    columns = np.repeat(np.arange(settings.columns), RINGS)
    rings = np.tile(np.arange(RINGS), settings.columns)
    azimuth = 2.0 * np.pi * columns / settings.columns
    elevation = (rings - 0.5 * (RINGS - 1)) * RING_SPACING_RAD
    directions = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=1,
    )
    period_s = 1.0 / settings.rotation_hz
    offsets_s = columns * (period_s / settings.columns) + rings * _FIRING_S
    return BeamPattern(directions, rings.astype(np.uint8), offsets_s)


def intensity(
    reflectance: FloatArray,
    range_m: FloatArray,
    incidence_cos: FloatArray,
    settings: SpinningLidarSettings,
    rng: np.random.Generator,
) -> FloatArray:
    """(N,) whole numbers from 0 to 255, as the driver reports them."""
    falloff = (settings.reference_range_m / range_m) ** settings.range_exponent
    clean = _DIFFUSE_FULL_SCALE * reflectance * falloff
    clean = clean * incidence_cos**settings.incidence_exponent
    noisy = clean * (1.0 + settings.intensity_noise * rng.standard_normal(clean.shape))
    return np.clip(np.rint(noisy), 0.0, _INTENSITY_MAX)


def noisy_range(
    range_m: FloatArray, settings: SpinningLidarSettings, rng: np.random.Generator
) -> FloatArray:
    """(N,) measured ranges."""
    noisy = range_m + settings.range_sigma_m * rng.standard_normal(range_m.shape)
    if settings.range_quantum_m > 0.0:
        noisy = np.rint(noisy / settings.range_quantum_m) * settings.range_quantum_m
    return noisy
