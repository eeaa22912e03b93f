"""``calibrate camera`` of a recording with its evidence, for the page: nothing is written."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from fusion_core.calibration.coloring import ColoringSettings, color_points
from fusion_core.calibration.features.camera_calibration import (
    CameraCalibration,
    calibrate_by_features,
)
from fusion_core.lens.projection import inside_image, project_points
from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray, read_only
from fusion_core.model.geometry import transform_points
from fusion_core.model.progress import Progress
from fusion_core.model.sensors import CameraIntrinsics, PointCloud
from fusion_core.workflows.calibrate.camera_input import CameraInput, read_camera_input
from fusion_core.workflows.calibrate.camera_settings import PRESETS

# Points that are drawn over an image: each pixel of a small picture about once.
_DRAWN_POINTS = 60_000
# A browser draws so many at once.
_COLORED_POINTS = 150_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CloudInImage:
    """Points of a cloud that are in an image, the farthest first: their ``pixels`` (N, 2) and
    ``depth_m`` (N,)."""

    pixels: FloatArray
    depth_m: FloatArray

    def __post_init__(self) -> None:
        read_only(self.pixels)
        read_only(self.depth_m)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColoredCloud:
    """Some of the points that the camera sees: ``points_m`` (N, 3) in the LiDAR's frame, ``rgb``
    (N, 3)."""

    points_m: Float32Array
    rgb: ByteArray

    def __post_init__(self) -> None:
        read_only(self.points_m)
        read_only(self.rgb)


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedCalibration:
    """A calibration with what it was made from. ``now``: the cloud in the image by the result;
    ``before``: by the guess, None without one that differs. ``colored``: the cloud in the image's
    colours (Fig. 12)."""

    calibration: CameraCalibration
    given: CameraInput
    colored: ColoredCloud
    grey: ByteArray
    now: CloudInImage
    before: CloudInImage | None


def calibrate_recorded_camera(
    recording: Path, image_topic: str, guess_file: Path | None, progress: Progress
) -> RecordedCalibration:
    """Calibrate the recorded turn with the first image of a topic. Raises as ``calibrate_camera``
    for what cannot be read or estimated."""
    settings = PRESETS["default"]
    given = read_camera_input(
        recording,
        Path(image_topic),
        intrinsics_file=None,
        guess_file=guess_file,
        points=None,
        joint=None,
        settings=settings,
        progress=progress,
    )
    grey: ByteArray = np.asarray(cv2.cvtColor(given.rgb, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    calibration = calibrate_by_features(
        given.cloud,
        grey,
        given.intrinsics,
        settings,
        T_guess=given.T_guess,
        progress=progress,
    )
    estimate = calibration.estimate
    before = None
    if estimate.T_guess is not None and estimate.improved:
        before = cloud_in_image(given.cloud, given.intrinsics, estimate.T_guess)
    return RecordedCalibration(
        calibration=calibration,
        given=given,
        colored=color_cloud(given, estimate.T_camera_lidar, settings.coloring),
        grey=grey,
        now=cloud_in_image(given.cloud, given.intrinsics, estimate.T_camera_lidar),
        before=before,
    )


def color_cloud(
    given: CameraInput, T_camera_lidar: FloatArray, settings: ColoringSettings
) -> ColoredCloud:
    """The cloud as the camera colours it by a pose (4, 4)."""
    rgb, seen = color_points(
        given.cloud.xyz_m, given.rgb, given.intrinsics, T_camera_lidar, settings
    )
    chosen = np.flatnonzero(seen)
    chosen = chosen[:: max(1, chosen.size // _COLORED_POINTS)]
    return ColoredCloud(points_m=given.cloud.xyz_m[chosen].astype(np.float32), rgb=rgb[chosen])


def cloud_in_image(
    cloud: PointCloud, intrinsics: CameraIntrinsics, T_camera_lidar: FloatArray
) -> CloudInImage:
    """Some points of a cloud, evenly spread over it, as a pose (4, 4) shows them."""
    points_m = cloud.xyz_m.astype(np.float64)
    points_m = points_m[np.isfinite(points_m).all(axis=1)]
    in_camera_m = transform_points(T_camera_lidar, points_m)
    pixels = project_points(in_camera_m, intrinsics)
    inside = np.flatnonzero(inside_image(pixels, intrinsics))
    inside = inside[:: max(1, inside.size // _DRAWN_POINTS)]
    depth_m = in_camera_m[inside, 2]
    order = np.argsort(-depth_m, kind="stable")
    return CloudInImage(pixels=pixels[inside][order], depth_m=depth_m[order])
