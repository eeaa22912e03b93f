"""Noise model of a structured-light depth camera (Kinect, Xtion): from true to reported depths."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.classes import SAME_SURFACE_M, NoiseClass
from fusion_core.model.conventions import BoolArray, ByteArray, Float32Array, FloatArray
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.settings import StageSettings, setting
from fusion_core.simulation.disturbances import (
    corner_bias_m,
    isolated,
    nearer,
    strictly_between,
)


class DepthNoise(StageSettings):
    """The errors of a depth camera.

    Khoshelham & Elberink 2012 measured on a Kinect that one step of disparity is 2.85e-3 z² metres,
    and the standard deviation 1.425e-3 z² including quantisation. The steps contribute
    2.85e-3 / sqrt(12) = 0.82e-3 of it, so the noise before quantisation is 1.16e-3. Mallick, Das &
    Majumdar 2014 survey the other errors (lost depth by distance, angle, shadow, material and
    sunlight; edges; speckles), Sarbolandi et al. 2015 compare them with those of time of flight:
    strong ambient light takes the depth away, corners bend much less. Where a help text names no
    source, the number is our choice.
    """

    sigma_per_m: float = setting(
        1.16e-3,
        "Standard deviation of the inverse depth before its quantisation",
        unit="1/m",
        ge=0.0,
        le=1.0,
    )
    disparity_step_per_m: float = setting(
        2.85e-3, "Step of the inverse depth", unit="1/m", ge=1e-6, le=1.0
    )
    step_m: float = setting(
        0.001, "Resolution of the image that is sent", unit="m", ge=1e-6, le=1.0
    )
    near_m: float = setting(0.5, "Nearer surfaces give nothing", unit="m", ge=1e-6, le=100.0)
    far_m: float = setting(8.0, "Farther surfaces give nothing", unit="m", ge=1e-6, le=1_000.0)
    projector_baseline_m: float = setting(
        0.075,
        "How far the projector is to the right of the camera: what it does not light is a hole",
        unit="m",
        ge=-1.0,
        le=1.0,
    )
    grazing_rad: float = setting(
        1.35,
        "From this incidence on pixels begin to be lost; at a right angle all are",
        unit="rad",
        ge=0.0,
        le=1.57,
    )
    dark_lost_fraction: float = setting(0.1, "Pixels lost on dark surfaces at 0 m", ge=0.0, le=1.0)
    dark_lost_per_m: float = setting(
        0.15,
        "Further pixels lost on dark surfaces, per metre of depth",
        unit="1/m",
        ge=0.0,
        le=10.0,
    )
    glass_front_rad: float = setting(
        0.1,
        "A pane may return the pattern within this angle of its normal",
        unit="rad",
        ge=0.0,
        le=1.6,
    )
    glass_front_fraction: float = setting(
        0.3, "Part of the pane that does, where it is not clean", ge=0.0, le=1.0
    )
    glass_through_fraction: float = setting(
        0.15,
        "Part of the rest of a pane that shows the depth of what lies behind it",
        ge=0.0,
        le=1.0,
    )
    mirror_front_rad: float = setting(
        0.1,
        "A mirror blinds the camera with its own projector within this angle of its normal",
        unit="rad",
        ge=0.0,
        le=1.6,
    )
    mirror_lost_fraction: float = setting(
        0.4,
        "Part of the rest of a mirror without depth; elsewhere the reflected room appears in it",
        ge=0.0,
        le=1.0,
    )
    sunlit_lost_fraction: float = setting(
        0.95,
        "Pixels lost where the sun shines on the surface and outshines the pattern",
        ge=0.0,
        le=1.0,
    )
    sunlit_sigma_factor: float = setting(
        3.0, "Standard deviation of the others there, relative to the usual", ge=1.0, le=100.0
    )
    corner_bias_m: float = setting(
        0.003,
        "How much too far a pixel reads in a concave corner of bright walls: much less than by time"
        " of flight, as the pattern is matched, not its delay (Sarbolandi et al. 2015)",
        unit="m",
        ge=0.0,
        le=1.0,
    )
    corner_span_m: float = setting(
        0.1, "Distance from such a corner at which this has faded", unit="m", ge=0.0, le=10.0
    )
    edge_jump_per_m: float = setting(
        0.012,
        "What counts as an edge: second difference of the inverse depth, zero on a plane",
        unit="1/m",
        ge=1e-6,
        le=10.0,
    )
    edge_lost_fraction: float = setting(
        0.3,
        "Pixels beside an edge that are lost: the matching window covers two surfaces",
        ge=0.0,
        le=1.0,
    )
    edge_mixed_fraction: float = setting(
        0.12, "Pixels beside an edge that fly between the two surfaces", ge=0.0, le=1.0
    )
    speckles: float = setting(
        22.0,
        "Mean number of speckles in 320 x 240 pixels: blobs of a wrong match",
        ge=0.0,
        le=10_000.0,
    )
    spike_fraction: float = setting(
        2e-4, "Fraction of single pixels with a wrong match nearer than the surface", ge=0.0, le=1.0
    )
    patches: float = setting(
        1.5,
        "Mean number of patches without depth in an image: glare, ambient light",
        ge=0.0,
        le=1_000.0,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthView:
    """What the noise depends on. All (H, W).

    ``true_m``: z of the first surface along the optical axis, finite. ``incidence_cos`` in
    [0, 1], 1 is head on. ``glass``, ``mirror``, ``dark``: its material. ``behind_m``: z of what
    lies behind a pane, or along the unfolded way over a mirror (NaN where there is neither).
    ``surface_draw``: in [0, 1), random and fixed to the surface, so that the parts of a pane or a
    mirror that show something stay the same from image to image. ``sunlit``: whether it is bright
    where the light comes from: on the surface, behind the pane, over the mirror. ``corner_m``: the
    surface's distance to the nearest concave corner, may be inf. ``shadowed``: seen by the camera,
    not lit by the projector.
    """

    true_m: FloatArray
    incidence_cos: FloatArray
    glass: BoolArray
    mirror: BoolArray
    dark: BoolArray
    sunlit: BoolArray
    shadowed: BoolArray
    behind_m: FloatArray
    surface_draw: FloatArray
    corner_m: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class NoisyDepth:
    """``depth_m``: (H, W) float32, NaN where lost. ``kinds``: (H, W) uint8 of NoiseClass."""

    depth_m: Float32Array
    kinds: ByteArray


def sigma_m(true_m: FloatArray, noise: DepthNoise) -> FloatArray:
    """The ordinary noise of a depth, with the quantisations of inverse depth and of depth."""
    disparity = noise.sigma_per_m**2 + noise.disparity_step_per_m**2 / 12.0
    return np.sqrt(disparity * true_m**4 + noise.step_m**2 / 12.0)


def add_noise(view: DepthView, noise: DepthNoise, rng: np.random.Generator) -> NoisyDepth:
    """A depth image as the sensor reports it, and each pixel's kind.

    A pixel is a burr where something other than ordinary noise formed its value *and* the value
    is off the truth by more than three standard deviations and by more than SAME_SURFACE_M: a mixed
    pixel at a low edge may be good. A depth from behind a pane or over a mirror is a burr: no
    surface stands there. A speckle is a wrong match, which may lie before or behind the surface.
    """
    true_m = view.true_m
    shape = true_m.shape
    inverse = 1.0 / true_m
    # Draws of their own: a disturbance of one kind does not shift those of the others.
    sun_rng, spike_rng = rng.spawn(2)

    silent, beyond = _panes_and_mirrors(view, noise)
    lost = view.shadowed | silent
    lost |= view.dark & (
        rng.random(shape) < noise.dark_lost_fraction + noise.dark_lost_per_m * true_m
    )
    grazing = np.arccos(np.minimum(view.incidence_cos, 1.0)) - noise.grazing_rad
    lost |= rng.random(shape) < grazing / (0.5 * np.pi - noise.grazing_rad)
    lost |= _patches(shape, noise, rng)

    corner_m = corner_bias_m(view.corner_m, noise.corner_bias_m, noise.corner_span_m)
    aimed = np.where(corner_m > 0.0, 1.0 / (true_m + corner_m), inverse)
    aimed[beyond] = 1.0 / view.behind_m[beyond]

    beside, other = _edges(inverse, noise.edge_jump_per_m)
    # Between two values there must be a third.
    beside &= np.abs(1.0 / other - true_m) > 2.0 * noise.step_m
    draw = rng.random(shape)
    lost |= beside & (draw < noise.edge_lost_fraction)
    mixed = beside & (draw > 1.0 - noise.edge_mixed_fraction) & ~beyond
    weight = rng.uniform(0.15, 0.85, shape)
    aimed = np.where(mixed, inverse + weight * (other - inverse), aimed)
    speckled, shift_m = _speckles(shape, noise, rng)
    aimed[speckled] = 1.0 / np.maximum(1.0 / aimed[speckled] + shift_m[speckled], noise.near_m)
    spikes = isolated(shape, noise.spike_fraction, spike_rng)
    aimed[spikes] = 1.0 / nearer(true_m[spikes], noise.near_m, spike_rng)
    disturbed = mixed | speckled | spikes | beyond | view.sunlit | (corner_m > 0.0)

    lost |= view.sunlit & (sun_rng.random(shape) < noise.sunlit_lost_fraction)
    sigma = noise.sigma_per_m * np.where(view.sunlit, noise.sunlit_sigma_factor, 1.0)
    measured = aimed + rng.standard_normal(shape) * sigma
    steps = np.rint(measured / noise.disparity_step_per_m)
    lost |= steps < 1.0
    value_m = 1.0 / (np.maximum(steps, 1.0) * noise.disparity_step_per_m)
    value_m = np.rint(value_m / noise.step_m) * noise.step_m
    between_m = strictly_between(value_m, true_m, 1.0 / other, noise.step_m)
    value_m = np.where(mixed & ~speckled & ~spikes, between_m, value_m)
    before_m = np.floor(true_m / noise.step_m) * noise.step_m
    value_m = np.where(spikes, np.minimum(value_m, before_m), value_m)
    lost |= (value_m < noise.near_m) | (value_m > noise.far_m)

    ordinary_m = np.maximum(3.0 * sigma_m(true_m, noise), SAME_SURFACE_M)
    far_off = disturbed & (np.abs(value_m - true_m) > ordinary_m)
    kinds = np.where(far_off, NoiseClass.BURR, NoiseClass.GOOD)
    kinds = np.where(lost, NoiseClass.HOLE, kinds).astype(np.uint8)
    return NoisyDepth(depth_m=np.where(lost, np.nan, value_m).astype(np.float32), kinds=kinds)


def _panes_and_mirrors(view: DepthView, noise: DepthNoise) -> tuple[BoolArray, BoolArray]:
    """(H, W) where a pane or a mirror gives nothing, and where it gives what lies beyond it."""
    draw = view.surface_draw
    facing_pane = view.incidence_cos >= np.cos(noise.glass_front_rad)
    returns = view.glass & facing_pane & (draw < noise.glass_front_fraction)
    # The rest of the draws is uniform again when it is stretched to [0, 1).
    left = (draw - noise.glass_front_fraction) / max(1.0 - noise.glass_front_fraction, 1e-9)
    rest = np.where(facing_pane, left, draw)
    through = view.glass & ~returns & (rest < noise.glass_through_fraction)
    blinded = view.incidence_cos >= np.cos(noise.mirror_front_rad)
    reflects = view.mirror & ~blinded & (draw >= noise.mirror_lost_fraction)
    silent = (view.glass & ~returns & ~through) | (view.mirror & ~reflects)
    return silent, through | reflects


def pixel_rays(intrinsics: CameraIntrinsics) -> FloatArray:
    """(H * W, 3) rays in the optical frame with z = 1, row by row: a distance along one is z."""
    u, v = np.meshgrid(np.arange(intrinsics.width), np.arange(intrinsics.height))
    x = (u - intrinsics.cx) / intrinsics.fx
    y = (v - intrinsics.cy) / intrinsics.fy
    return np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)


def _edges(inverse: FloatArray, jump: float) -> tuple[BoolArray, FloatArray]:
    """(H, W) whether a pixel lies beside an edge, and the inverse depth across it."""
    beside = np.zeros(inverse.shape, dtype=np.bool_)
    other = inverse.copy()
    for axis in (0, 1):
        width = [(1, 1) if axis == 0 else (0, 0), (1, 1) if axis == 1 else (0, 0)]
        padded = np.pad(inverse, width, mode="edge")
        before = padded[:-2] if axis == 0 else padded[:, :-2]
        after = padded[2:] if axis == 0 else padded[:, 2:]
        # On a plane the inverse depth is linear in u and v.
        bent = np.abs(before - 2.0 * inverse + after) > jump
        across = np.where(np.abs(before - inverse) > np.abs(after - inverse), before, after)
        other = np.where(bent, across, other)
        beside |= bent
    return beside, other


def _speckles(
    shape: tuple[int, ...], noise: DepthNoise, rng: np.random.Generator
) -> tuple[BoolArray, FloatArray]:
    """Blobs of 1 to about 20 pixels, each with a shift of 0.15-1 m nearer or farther."""
    speckled = np.zeros(shape, dtype=np.bool_)
    shift_m = np.zeros(shape)
    for _ in range(int(rng.poisson(noise.speckles * shape[0] * shape[1] / (320 * 240)))):
        blob = _disc(shape, rng, (0.5, 2.5))
        speckled |= blob
        shift_m[blob] = rng.uniform(0.15, 1.0) * rng.choice([-1.0, 1.0])
    return speckled, shift_m


def _patches(shape: tuple[int, ...], noise: DepthNoise, rng: np.random.Generator) -> BoolArray:
    """Ellipses with half axes of 4 to 18 pixels."""
    lost = np.zeros(shape, dtype=np.bool_)
    for _ in range(int(rng.poisson(noise.patches))):
        lost |= _disc(shape, rng, (4.0, 18.0))
    return lost


def _disc(
    shape: tuple[int, ...], rng: np.random.Generator, radii: tuple[float, float]
) -> BoolArray:
    row, column = rng.uniform(0.0, shape[0]), rng.uniform(0.0, shape[1])
    height, width = rng.uniform(*radii, 2)
    rows = (np.arange(shape[0])[:, None] - row) / height
    columns = (np.arange(shape[1])[None, :] - column) / width
    inside: BoolArray = rows**2 + columns**2 < 1.0
    return inside
