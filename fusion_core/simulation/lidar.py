"""Noise model of a 2D LiDAR, by default a URG-04LX: from true ranges to reported ones."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.classes import SAME_SURFACE_M, NoiseClass
from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray
from fusion_core.settings import StageSettings, setting
from fusion_core.simulation.disturbances import (
    corner_bias_m,
    isolated,
    nearer,
    strictly_between,
)

# Ranges at which data sheets of triangulating scanners change the accuracy.
_BANDS_M = (3.0, 5.0)


class LidarNoise(StageSettings):
    """Errors of a 2D LiDAR. Defaults: URG-04LX, from its data sheet where that has the value.

    Mixed pixels, lost dark surfaces and lost grazing beams are those that Kneip et al. 2009 and
    Okubo, Ye & Borenstein 2009 describe for this sensor, mirrors those of Yang & Wang 2011, corners
    those that Sarbolandi et al. 2015 find with sensors that measure time of flight. These papers
    show that the errors exist; where a help text names no source, the number is our choice.
    """

    sigma_near_m: float = setting(
        0.01,
        "Standard deviation up to 1 m (data sheet of the URG-04LX: 10 mm)",
        unit="m",
        ge=0.0,
        le=1.0,
    )
    relative_sigma: float = setting(
        0.01, "Standard deviation beyond 1 m, per metre of range (data sheet: 1 %)", ge=0.0, le=0.2
    )
    relative_sigma_middle: float = setting(
        0.01, "Standard deviation from 3 m on, per metre of range", ge=0.0, le=0.2
    )
    relative_sigma_far: float = setting(
        0.01, "Standard deviation from 5 m on, per metre of range", ge=0.0, le=0.2
    )
    step_m: float = setting(
        0.001, "Resolution of a range (data sheet: 1 mm)", unit="m", ge=1e-6, le=1.0
    )
    glass_front_rad: float = setting(
        0.14,
        "A pane returns a beam only within this angle of its normal, where the reflection of the"
        " emitter meets the receiver",
        unit="rad",
        ge=0.0,
        le=1.6,
    )
    glass_through_fraction: float = setting(
        0.15,
        "Fraction of the other beams on glass that measure what lies behind it",
        ge=0.0,
        le=1.0,
    )
    mirror_front_rad: float = setting(
        0.05,
        "A mirror itself returns a beam only within this angle of its normal; farther from it a"
        " beam is reflected and reports the length of the folded path (Yang & Wang 2011)",
        unit="rad",
        ge=0.0,
        le=1.6,
    )
    mirror_lost_fraction: float = setting(
        0.1, "Fraction of the reflected beams that do not come back", ge=0.0, le=1.0
    )
    sunlit_lost_fraction: float = setting(
        0.5,
        "Beams lost where the sun shines on the surface: the data sheet allows 10 000 lx, the sun"
        " behind a window gives several times that",
        ge=0.0,
        le=1.0,
    )
    sunlit_sigma_factor: float = setting(
        3.0, "Standard deviation of the others there, relative to the usual", ge=1.0, le=100.0
    )
    dark_lost_fraction: float = setting(
        0.25,
        "Beams lost on dark surfaces at 0 m; the sheet's range is for white paper",
        ge=0.0,
        le=1.0,
    )
    dark_lost_per_m: float = setting(
        0.12, "Further beams lost on dark surfaces, per metre of range", unit="1/m", ge=0.0, le=10.0
    )
    grazing_rad: float = setting(
        1.4,
        "From this incidence on beams begin to be lost; at a right angle all are",
        unit="rad",
        ge=0.0,
        le=1.57,
    )
    lost_runs: float = setting(
        3.0,
        "Mean number of runs of lost beams in a sweep, as by ambient light or cables",
        ge=0.0,
        le=1_000.0,
    )
    lost_run_beams: float = setting(
        6.0, "Mean length of such a run", unit="beams", ge=1.0, le=10_000.0
    )
    edge_mixed_fraction: float = setting(
        0.7,
        "Beams beside an edge that average both surfaces (mixed pixels: Kneip et al. 2009 on"
        " the URG-04LX)",
        ge=0.0,
        le=1.0,
    )
    edge_jump_per_m: float = setting(
        0.02,
        "What counts as an edge: second difference of the inverse range, zero on a plane",
        unit="1/m",
        ge=1e-6,
        le=10.0,
    )
    spurious_fraction: float = setting(
        0.005,
        "Fraction of spurious returns, anywhere before the first opaque surface: cross talk, steam",
        ge=0.0,
        le=1.0,
    )
    spike_fraction: float = setting(
        0.002,
        "Fraction of single beams that a particle in the air returns, most of them close by",
        ge=0.0,
        le=1.0,
    )
    corner_bias_m: float = setting(
        0.02,
        "How much too far a beam reads in a concave corner of bright walls, by the light that comes"
        " back over the other wall (time of flight: Sarbolandi et al. 2015)",
        unit="m",
        ge=0.0,
        le=1.0,
    )
    corner_span_m: float = setting(
        0.15, "Distance from such a corner at which this has faded", unit="m", ge=0.0, le=10.0
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarView:
    """What the noise depends on. All (N,), in the order of the beams.

    ``true_m``: range of the first surface, finite. ``incidence_cos`` in [0, 1], 1 is head on.
    ``glass``, ``mirror``, ``dark``: its material. ``behind_m``: range of what lies behind a pane,
    or length of the way over a mirror (NaN where there is neither). ``sunlit``: whether it is
    bright where the light comes from: on the surface, behind the pane, over the mirror.
    ``corner_m``: the surface's distance to the nearest concave corner, may be inf.
    """

    true_m: FloatArray
    incidence_cos: FloatArray
    glass: BoolArray
    mirror: BoolArray
    dark: BoolArray
    sunlit: BoolArray
    behind_m: FloatArray
    corner_m: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class NoisySweep:
    """``ranges_m``: (N,) float64, NaN where lost. ``kinds``: (N,) uint8 of NoiseClass."""

    ranges_m: FloatArray
    kinds: ByteArray


def sigma_m(true_m: FloatArray, noise: LidarNoise) -> FloatArray:
    """The ordinary noise of a range."""
    relative_sigmas = (noise.relative_sigma, noise.relative_sigma_middle, noise.relative_sigma_far)
    relative_sigma = np.array(relative_sigmas)[np.searchsorted(_BANDS_M, true_m, side="right")]
    return np.maximum(noise.sigma_near_m, relative_sigma * true_m)


def add_noise(
    view: LidarView,
    noise: LidarNoise,
    range_limits_m: tuple[float, float],
    rng: np.random.Generator,
) -> NoisySweep:
    """A sweep as the sensor reports it, and each beam's kind.

    A beam is a burr where something other than ordinary noise formed its value *and* the value is
    off the truth by more than three standard deviations and by more than SAME_SURFACE_M: a mixed
    beam at a low edge may be good. What a beam measures behind a pane or over a mirror is a burr:
    no surface stands there in its direction, or none that a robot could reach.
    """
    true_m = view.true_m
    count = true_m.size
    # Draws of their own: a disturbance of one kind does not shift those of the others.
    mirror_rng, sun_rng, spike_rng = rng.spawn(3)
    aimed_m = true_m.copy()
    disturbed = np.zeros(count, dtype=np.bool_)

    silent_glass = view.glass & (view.incidence_cos < np.cos(noise.glass_front_rad))
    through = silent_glass & (rng.random(count) < noise.glass_through_fraction)
    lost = silent_glass & ~through
    reflected = view.mirror & (view.incidence_cos < np.cos(noise.mirror_front_rad))
    lost |= reflected & (mirror_rng.random(count) < noise.mirror_lost_fraction)
    beyond = through | reflected
    aimed_m[beyond] = view.behind_m[beyond]
    disturbed |= beyond

    lost |= view.dark & (
        rng.random(count) < noise.dark_lost_fraction + noise.dark_lost_per_m * true_m
    )

    grazing = np.arccos(np.minimum(view.incidence_cos, 1.0)) - noise.grazing_rad
    lost |= rng.random(count) < grazing / (0.5 * np.pi - noise.grazing_rad)

    corner_m = corner_bias_m(view.corner_m, noise.corner_bias_m, noise.corner_span_m)
    aimed_m += np.where(beyond, 0.0, corner_m)
    disturbed |= corner_m > 0.0

    beside, other_m = _edges(true_m, noise.edge_jump_per_m)
    # Between two values there must be a third.
    beside &= np.abs(other_m - true_m) > 2.0 * noise.step_m
    mixed = beside & (rng.random(count) < noise.edge_mixed_fraction) & ~beyond
    weight = rng.uniform(0.1, 0.9, count)
    aimed_m[mixed] = (true_m + weight * (other_m - true_m))[mixed]
    disturbed |= mixed

    # Light that comes back from before the first opaque surface: nothing passes through that.
    opaque_m = np.where(view.glass, view.behind_m, true_m)
    nearest_m, farthest_m = range_limits_m
    spurious = rng.random(count) < noise.spurious_fraction
    reach_m = np.minimum(opaque_m, farthest_m) - nearest_m
    aimed_m[spurious] = (nearest_m + rng.random(count) * reach_m)[spurious]
    spikes = isolated((count,), noise.spike_fraction, spike_rng)
    aimed_m[spikes] = nearer(true_m, nearest_m, spike_rng)[spikes]
    early = spurious | spikes
    disturbed |= early

    sigma = sigma_m(aimed_m, noise)
    sigma[view.sunlit] *= noise.sunlit_sigma_factor
    disturbed |= view.sunlit
    lost |= view.sunlit & (sun_rng.random(count) < noise.sunlit_lost_fraction)
    value_m = aimed_m + rng.standard_normal(count) * sigma
    value_m = np.rint(value_m / noise.step_m) * noise.step_m
    between_m = strictly_between(value_m, true_m, other_m, noise.step_m)
    value_m = np.where(mixed & ~early, between_m, value_m)
    before_m = np.floor(opaque_m / noise.step_m) * noise.step_m
    value_m = np.where(early, np.minimum(value_m, before_m), value_m)
    lost |= _lost_runs(count, noise, rng)
    lost |= ~np.isfinite(value_m) | (value_m < nearest_m) | (value_m > farthest_m)

    ordinary_m = np.maximum(3.0 * sigma_m(true_m, noise), SAME_SURFACE_M)
    far_off = disturbed & (np.abs(value_m - true_m) > ordinary_m)
    kinds = np.where(far_off, NoiseClass.BURR, NoiseClass.GOOD)
    kinds = np.where(lost, NoiseClass.HOLE, kinds).astype(np.uint8)
    return NoisySweep(ranges_m=np.where(lost, np.nan, value_m), kinds=kinds)


def _edges(true_m: FloatArray, jump: float) -> tuple[BoolArray, FloatArray]:
    """(N,) whether a beam lies beside an edge, and the neighbour's range across it."""
    padded = np.pad(true_m, 1, mode="edge")
    before, after = padded[:-2], padded[2:]
    # On a plane 1/r is a sine of the azimuth: its second difference over one beam vanishes.
    bend = np.abs(1.0 / before - 2.0 / true_m + 1.0 / after)
    across = np.where(np.abs(before - true_m) > np.abs(after - true_m), before, after)
    return bend > jump, across


def _lost_runs(count: int, noise: LidarNoise, rng: np.random.Generator) -> BoolArray:
    lost = np.zeros(count, dtype=np.bool_)
    for _ in range(int(rng.poisson(noise.lost_runs))):
        start = int(rng.integers(count))
        lost[start : start + int(rng.geometric(1.0 / noise.lost_run_beams))] = True
    return lost
