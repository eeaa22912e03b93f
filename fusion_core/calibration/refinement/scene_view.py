"""What a camera sees of a cloud, blurred from coarse to fine."""

from dataclasses import dataclass

import numpy as np

from fusion_core.calibration.refinement.alignment_evidence import (
    EvidenceLevel,
    VisibleCloud,
    blur_evidence,
    see_cloud,
)
from fusion_core.calibration.refinement.beam_neighbours import find_beam_neighbours
from fusion_core.calibration.refinement.guess_input import in_image
from fusion_core.calibration.refinement.pose_search import bearing_metric, step_basis
from fusion_core.calibration.refinement.rectified_image import RectifiedImage, rectify_image
from fusion_core.model.conventions import ByteArray, FloatArray
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.sensors import CameraIntrinsics

BLOCKS = (8, 2)
"""Columns and rows of the image's checkerboard: enough blocks for a covariance of six
parameters."""

# Pixels of the image between neighbouring beams: edges are blurred by half of that at least.
_BEAM_PX = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneView:
    """What the camera sees of the cloud from one pose, at all levels from coarse to fine."""

    cloud: VisibleCloud
    levels: tuple[EvidenceLevel, ...]
    bases: tuple[FloatArray, ...]
    metric: FloatArray


def rectify_to_beams(
    points: FloatArray, grey: ByteArray, intrinsics: CameraIntrinsics, T_guess: FloatArray
) -> RectifiedImage:
    """The image at as many pixels a beam as matter."""
    inside = in_image(points, intrinsics, T_guess)
    spacing_px = find_beam_neighbours(points[inside]).spacing_rad * intrinsics.fx
    return rectify_image(grey, intrinsics, min(1.0, _BEAM_PX / max(spacing_px, 1e-9)))


def view_scene(
    points: FloatArray,
    intensity: FloatArray | None,
    image: RectifiedImage,
    T_camera_lidar: FloatArray,
    precision: FloatArray,
    first_sigma_rad: float,
) -> SceneView:
    """The view from one pose, its coarsest blur ``first_sigma_rad``. ``precision``: (6, 6) of the
    prior.

    Raises CalibrationFailed where no point is seen.
    """
    cloud = see_cloud(points, intensity, image, T_camera_lidar, BLOCKS)
    if not cloud.families or not len(cloud.seen_in_lidar_m):
        raise CalibrationFailed("None of the cloud's points is seen in the image.")
    metric = bearing_metric(cloud.seen_in_lidar_m, T_camera_lidar)
    sigmas = _sigmas(first_sigma_rad, cloud.spacing_rad)
    return SceneView(
        cloud=cloud,
        levels=tuple(blur_evidence(cloud, image, T_camera_lidar, sigma) for sigma in sigmas),
        bases=tuple(step_basis(metric, precision, sigma) for sigma in sigmas),
        metric=metric,
    )


def _sigmas(first_rad: float, spacing_rad: float) -> list[float]:
    """Blurs from the size of the guess's error, each half of the one before, to half the distance
    of neighbouring beams: an edge lies anywhere between two."""
    last_rad = 0.5 * spacing_rad
    sigmas = []
    while first_rad > np.sqrt(2.0) * last_rad:
        sigmas.append(first_rad)
        first_rad *= 0.5
    return [*sigmas, last_rad] if sigmas else [2.0 * last_rad, last_rad]
