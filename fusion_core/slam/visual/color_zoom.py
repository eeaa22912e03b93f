"""Whether the colour image shows the same as the depth image, or more or less of it.

Recordings whose colour is not registered to depth often name one lens for both. Where the colour
lens has a shorter focal length, its features lie nearer to the image's centre than the depth image
says, and a turn of the camera is taken for a smaller one. Between two images the depths say how the
camera moved (``align_depths``) and the features where their points went: the zoom z, by which the
colour image must be magnified about its principal point c, is what brings both together:

    (project(T X(c + z (u1 - c))) - c) / z + c = u2

with X the depth image's point below a pixel and T the motion, which is estimated beside z.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice

import cv2
import numpy as np

from fusion_core.model.conventions import FloatArray, read_only
from fusion_core.model.progress import Progress, silent
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.motion.feature_matching import match_descriptors
from fusion_core.motion.ransac_pnp import ransac_pnp
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.visual.depth_alignment import align_depths
from fusion_core.slam.visual.depth_surface import DepthSurface, SurfaceSampler
from fusion_core.slam.visual.features import FeatureExtractor, FeatureSettings
from fusion_core.slam.visual.frame_features import FrameFeatures
from fusion_core.slam.visual.observation_noise import CHI2_PIXEL, ObservationNoise
from fusion_core.slam.visual.pinhole import camera_parameters, project
from fusion_core.slam.visual.pose_optimisation import exp_se3

# Images from one of a pair to the next: far enough for a motion, near enough to match.
_STEP_IMAGES = 6
_MATCHES_MIN = 30
_RATIO_MAX = 0.8
_OVERLAP_MIN = 0.25
_ITERATIONS = 10
# So many standard deviations from 1 is a zoom; and at least this much: what smaller errors of a
# camera matrix do cannot be told from it.
_SIGNIFICANT = 4.0
_LEAST = 0.02


class ColorZoomSettings(StageSettings):
    """Settings of ``estimate_color_zoom``."""

    images_max: int = setting(
        240,
        "First images by which the zoom of colour against depth is measured; 0 to trust them to "
        "show the same",
        unit="images",
        ge=0,
        le=100_000,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ColorZoom:
    """``zoom``: what the colour image must be magnified by, with its standard deviation; ``pairs``
    of images were used."""

    zoom: float
    sigma: float
    pairs: int

    @property
    def is_significant(self) -> bool:
        """Whether colour and depth are certain to show different parts."""
        return abs(self.zoom - 1.0) > max(_SIGNIFICANT * self.sigma, _LEAST)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Pair:
    """M matches: ``first``, ``second``: (M, 2) pixels, ``sigmas``: (M,). ``surface``: of the first.
    ``motion``: (4, 4) T_second_first by depth with its ``information``, (6, 6)."""

    first: FloatArray
    second: FloatArray
    sigmas: FloatArray
    surface: DepthSurface
    motion: FloatArray
    information: FloatArray

    def __post_init__(self) -> None:
        for array in (self.first, self.second, self.sigmas, self.motion, self.information):
            read_only(array)


def estimate_color_zoom(
    frames: Iterable[RgbdFrame],
    intrinsics: CameraIntrinsics,
    settings: ColorZoomSettings,
    features: FeatureSettings,
    noise: ObservationNoise,
    progress: Progress = silent,
    *,
    image_count: int | None = None,
) -> ColorZoom | None:
    """By the first of the frames, of ``image_count`` if that is known; None where they tell
    nothing: no motion, texture or depth."""
    compared = None if image_count is None else min(image_count, settings.images_max)
    extractor, sampler = FeatureExtractor(intrinsics, features), SurfaceSampler(intrinsics)
    camera = camera_parameters(intrinsics)
    pairs: list[_Pair] = []
    before: tuple[FrameFeatures, DepthSurface] | None = None
    for number, frame in enumerate(islice(frames, 0, settings.images_max, _STEP_IMAGES)):
        progress(number * _STEP_IMAGES, compared, "comparing colour with depth")
        now = extractor.extract(frame), sampler.surface(sampler.reduce(frame.depth_m))
        if before is not None:
            pair = _pair(*before, *now, camera, noise)
            if pair is not None:
                pairs.append(pair)
        before = now
    return _fit(pairs, camera) if pairs else None


def _pair(
    first: FrameFeatures,
    first_surface: DepthSurface,
    second: FrameFeatures,
    second_surface: DepthSurface,
    camera: FloatArray,
    noise: ObservationNoise,
) -> _Pair | None:
    if min(len(first), len(second)) < _MATCHES_MIN:
        return None
    matches = match_descriptors(first.descriptors, second.descriptors, ratio_max=_RATIO_MAX)
    if len(matches) < _MATCHES_MIN:
        return None
    of_first, of_second = matches.T
    points = _points_below(first_surface, first.pixels[of_first], camera, 1.0)
    known = np.isfinite(points[:, 2])
    if np.count_nonzero(known) < _MATCHES_MIN:
        return None
    fx, fy, cx, cy = camera
    start = ransac_pnp(
        points[known],
        second.pixels[of_second[known]],
        np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        draws=300,
        threshold=6.0,
        confidence=0.999,
        method=cv2.SOLVEPNP_EPNP,
    )
    if start is None:
        return None
    aligned = align_depths(
        first_surface, second_surface, start[0], noise.depth_sigma_per_m2, _OVERLAP_MIN
    )
    if aligned is None:
        return None
    return _Pair(
        first=first.pixels[of_first],
        second=second.pixels[of_second],
        sigmas=noise.pixel_sigmas(first.octaves[of_first]),
        surface=first_surface,
        motion=aligned[0],
        information=aligned[1],
    )


def _fit(pairs: list[_Pair], camera: FloatArray) -> ColorZoom | None:
    """Gauss-Newton over the zoom and each pair's motion, which is eliminated."""
    zoom = 1.0
    motions = [np.zeros(6) for _ in pairs]
    weights = gradients = np.zeros(len(pairs))
    for _ in range(_ITERATIONS):
        solved = [
            _normal_equations(pair, x, zoom, camera) for pair, x in zip(pairs, motions, strict=True)
        ]
        weights = np.array([h - c @ np.linalg.solve(H, c) for H, c, h, _, _ in solved])
        gradients = np.array([k - c @ np.linalg.solve(H, b) for H, c, _, b, k in solved])
        if weights.sum() <= 0.0:
            return None
        step = float(-gradients.sum() / weights.sum())
        zoom += step
        motions = [
            x - np.linalg.solve(H, b + c * step)
            for x, (H, c, _, b, _) in zip(motions, solved, strict=True)
        ]
        if not 0.5 < zoom < 2.0:
            return None
    # By how the pairs disagree, not by the noise that each is said to have.
    sigma = float(np.sqrt((gradients**2).sum()) / weights.sum())
    return ColorZoom(zoom=zoom, sigma=sigma, pairs=len(pairs))


def _normal_equations(
    pair: _Pair, x: FloatArray, zoom: float, camera: FloatArray
) -> tuple[FloatArray, FloatArray, float, FloatArray, float]:
    """(6, 6) of the motion, (6,) of both, that of the zoom; (6,) and the zoom's gradient."""
    origin = _errors(pair, x, zoom, camera)
    steps = np.array([1e-4] * 6 + [1e-3])
    columns = [
        (_errors(pair, x + d[:6], zoom + d[6], camera) - origin) / step
        for d, step in zip(np.diag(steps), steps, strict=True)
    ]
    J = np.stack(columns, axis=-1)
    chi2 = (origin**2).sum(axis=1)
    known = np.isfinite(chi2) & np.isfinite(J).all(axis=(1, 2))
    # Cauchy: matches may be wrong.
    weight = 1.0 / (1.0 + chi2[known] / CHI2_PIXEL)
    J, r = J[known], origin[known]
    H = np.einsum("n,nij,nik->jk", weight, J, J)
    g = np.einsum("n,nij,ni->j", weight, J, r)
    H_motion = H[:6, :6] + pair.information + 1e-9 * np.eye(6)
    return H_motion, H[:6, 6], float(H[6, 6]), g[:6] + pair.information @ x, float(g[6])


def _errors(pair: _Pair, x: FloatArray, zoom: float, camera: FloatArray) -> FloatArray:
    """(M, 2) in standard deviations; NaN where there is no depth."""
    points = _points_below(pair.surface, pair.first, camera, zoom)
    T = exp_se3(x) @ pair.motion
    pixels = project(points @ T[:3, :3].T + T[:3, 3], camera)
    centre = camera[2:]
    errors: FloatArray = (pixels - centre) / zoom + centre - pair.second
    return errors / pair.sigmas[:, np.newaxis]


def _points_below(
    surface: DepthSurface, pixels: FloatArray, camera: FloatArray, zoom: float
) -> FloatArray:
    """(M, 3) where the rays of (M, 2) pixels, magnified, meet the surface."""
    rays = zoom * (pixels - camera[2:]) / camera[:2]
    at = np.rint(rays * surface.camera[:2] + surface.camera[2:]).astype(np.int64)
    height, width = surface.points_m.shape[:2]
    inside = (at >= 0).all(axis=1) & (at[:, 0] < width) & (at[:, 1] < height)
    columns, rows = np.clip(at, 0, [width - 1, height - 1]).T
    # The plane of the block, met by the pixel's own ray.
    point, normal = surface.points_m[rows, columns], surface.normals[rows, columns]
    directions = np.column_stack([rays, np.ones(len(rays))])
    z = (normal * point).sum(axis=1) / (normal * directions).sum(axis=1)
    z = np.where(inside & (np.abs(z - point[:, 2]) < 0.05 * point[:, 2]), z, np.nan)
    return directions * z[:, np.newaxis]
