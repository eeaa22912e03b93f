"""Pairs of a LiDAR's points and a camera's pixels, once the pose is roughly known.

The cloud is rendered as the camera would see it from there; then patches of the two pictures differ
by small shifts alone, which normalised cross-correlation finds to a fraction of a pixel.
"""

import cv2
import numpy as np

from fusion_core.calibration.features.cloud_filter import CloudFilterSettings
from fusion_core.calibration.features.feature_points import interpolated_points
from fusion_core.calibration.features.intensity_image import (
    IntensityImage,
    IntensityImageSettings,
    render_intensity_image,
)
from fusion_core.calibration.features.matched_pairs import MatchedPairs
from fusion_core.calibration.features.virtual_camera import VirtualCamera
from fusion_core.lens.projection import project_points
from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray, IntArray
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.settings import StageSettings, setting

# tan 60°: a pinhole picture of a wider field of view is mostly corners.
_HALF_VIEW_TAN_MAX = 1.73


class PatchSettings(StageSettings):
    """Settings of ``match_patches``."""

    corners_max: int = setting(1500, "Most corners of the intensity image", ge=20, le=10_000)
    corner_quality: float = setting(
        0.01, "Least strength of a corner, of the strongest one's", ge=1e-4, le=0.5
    )
    spacing_px: int = setting(
        6, "Least distance of two corners", unit="virtual pixels", ge=1, le=100
    )
    radius_px: int = setting(10, "Half the width of a patch", unit="virtual pixels", ge=3, le=50)
    correlation_min: float = setting(
        0.75, "Least normalised correlation of two patches", ge=0.1, le=0.999
    )
    runner_up_max: float = setting(
        0.9,
        "Greatest correlation of another place in the window, of the best one's",
        ge=0.1,
        le=1.0,
    )
    agreement_px: float = setting(
        0.3,
        "Greatest difference of the places that a patch and its inner half find",
        unit="virtual pixels",
        ge=0.01,
        le=10.0,
    )
    filled_min: float = setting(0.9, "Least fraction of a patch that is no hole", ge=0.1, le=1.0)
    edge_fraction: float = setting(
        0.1,
        "Points around a feature that depart more from a plane lie across a depth edge",
        unit="of the depth",
        ge=0.005,
        le=1.0,
    )
    plane_radius_px: int = setting(
        3, "Half the width of the window of that plane", unit="virtual pixels", ge=1, le=20
    )


def camera_view(
    T_camera_lidar: FloatArray, intrinsics: CameraIntrinsics, pixel_size: float
) -> VirtualCamera:
    """A virtual camera in the place of the camera, without its distortion."""
    f = 0.5 * (intrinsics.fx + intrinsics.fy)
    corners = np.array([[-0.5, -0.5], [intrinsics.width - 0.5, intrinsics.height - 0.5]])
    plane = (corners - (intrinsics.cx, intrinsics.cy)) / (intrinsics.fx, intrinsics.fy)
    plane = np.clip(plane, -_HALF_VIEW_TAN_MAX, _HALF_VIEW_TAN_MAX) * f
    (left, top), (right, bottom) = plane
    return VirtualCamera(
        T_view_lidar=T_camera_lidar.copy(),
        focal_px=f,
        width=int(right - left),
        height=int(bottom - top),
        cx=-left - 0.5,
        cy=-top - 0.5,
    ).with_pixel_size(pixel_size)


def camera_picture(
    grey: ByteArray, view: VirtualCamera, intrinsics: CameraIntrinsics, pixel_size: float
) -> Float32Array:
    """(H, W) the camera's image as the virtual camera ``view`` in its place would take it, NaN
    outside of the image."""
    columns, rows = np.meshgrid(np.arange(view.width), np.arange(view.height))
    rays = view.rays(np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.float64))
    at = project_points(rays, intrinsics).reshape(view.height, view.width, 2).astype(np.float32)
    # What one pixel of the view covers.
    sigma_px = 0.4 * max(1.0, pixel_size)
    image = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), sigma_px)
    u, v = np.nan_to_num(at[..., 0], nan=-1e6), np.nan_to_num(at[..., 1], nan=-1e6)
    seen = cv2.remap(
        image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan
    )
    return np.asarray(seen, dtype=np.float32)


def match_patches(
    points_m: FloatArray,
    intensity: FloatArray,
    grey: ByteArray,
    intrinsics: CameraIntrinsics,
    T_camera_lidar: FloatArray,
    *,
    pixel_size: float,
    search_px: float,
    image_settings: IntensityImageSettings,
    cloud_settings: CloudFilterSettings,
    settings: PatchSettings,
) -> tuple[MatchedPairs, IntensityImage]:
    """Pairs within ``search_px`` camera pixels of where ``T_camera_lidar`` projects the points."""
    view = camera_view(T_camera_lidar, intrinsics, pixel_size)
    image = render_intensity_image(
        points_m, intensity, view, pixel_size, image_settings, cloud_settings
    )
    seen = camera_picture(grey, view, intrinsics, pixel_size)
    corners = _corners(image, settings)
    reach = max(2, int(np.ceil(search_px / pixel_size)))
    shifts, reasons = _shifts(image.smooth, seen, corners, reach, settings)
    centres = corners.astype(np.float64)
    points, is_edge = interpolated_points(
        image, centres, radius_px=settings.plane_radius_px, edge_fraction=settings.edge_fraction
    )
    for i in np.flatnonzero(~np.isfinite(points).all(axis=1)):
        reasons[i] = reasons[i] or ("depth edge" if is_edge[i] else "no point")
    matched = project_points(view.rays(centres + np.nan_to_num(shifts)), intrinsics)
    lost = ~np.isfinite(matched).all(axis=1) & np.array([not reason for reason in reasons])
    reasons = [
        "outside the image" if is_lost else reason
        for is_lost, reason in zip(lost, reasons, strict=True)
    ]
    return (
        MatchedPairs(
            image_px=matched, intensity_px=centres, points_m=points, reasons=tuple(reasons)
        ),
        image,
    )


def _corners(image: IntensityImage, settings: PatchSettings) -> IntArray:
    known = np.isfinite(image.smooth)
    margin = settings.radius_px + 1
    mask = np.zeros(known.shape, dtype=np.uint8)
    mask[margin:-margin, margin:-margin] = known[margin:-margin, margin:-margin]
    found: object = cv2.goodFeaturesToTrack(
        image.picture,
        settings.corners_max,
        settings.corner_quality,
        settings.spacing_px,
        mask=mask,
        blockSize=5,
    )
    # None where there is no corner, which OpenCV's types do not say.
    corners = np.empty((0, 2)) if found is None else np.asarray(found).reshape(-1, 2)
    return np.round(corners).astype(np.int64)


def _shifts(
    smooth: Float32Array,
    seen: Float32Array,
    corners: IntArray,
    reach: int,
    settings: PatchSettings,
) -> tuple[FloatArray, list[str]]:
    """(N, 2) how far each corner's patch lies from its place in ``seen``, NaN where it has none,
    and the reasons why."""
    shifts = np.full((len(corners), 2), np.nan)
    reasons = [""] * len(corners)
    known = np.isfinite(smooth)
    if not known.any():
        return shifts, ["holes"] * len(corners)
    filled = np.where(known, smooth, np.nanmedian(smooth)).astype(np.float32)
    blank = ~np.isfinite(seen)
    picture = np.where(blank, 0.0, seen).astype(np.float32)
    height, width = smooth.shape
    radius = settings.radius_px
    for i, (u, v) in enumerate(corners.tolist()):
        wide = radius + reach
        if (
            u < wide
            or v < wide
            or u + wide >= width
            or v + wide >= height
            or blank[_square(u, v, wide)].any()
        ):
            reasons[i] = "outside the image"
        elif known[_square(u, v, radius)].mean() < settings.filled_min:
            reasons[i] = "holes"
        else:
            patch, window = filled[_square(u, v, radius)], picture[_square(u, v, wide)]
            shift, reasons[i] = _best_shift(patch, window, settings)
            if reasons[i]:
                continue
            # A patch of which a part looks otherwise to the LiDAR is drawn aside, and a smaller
            # one differently.
            inner = radius // 2 + 1
            about = np.round(shift).astype(np.int64)
            patch = filled[_square(u, v, inner)]
            window = picture[_square(u + int(about[0]), v + int(about[1]), inner + 2)]
            small, reason = _best_shift(patch, window, settings)
            if reason or np.abs(about + small - shift).max() > settings.agreement_px:
                reasons[i] = "patch sizes disagree"
            else:
                shifts[i] = shift
    return shifts, reasons


def _square(u: int, v: int, radius: int) -> tuple[slice, slice]:
    return np.s_[v - radius : v + radius + 1, u - radius : u + radius + 1]


def _best_shift(
    patch: Float32Array, window: Float32Array, settings: PatchSettings
) -> tuple[FloatArray, str]:
    """(2,) how far a patch lies from the middle of a window, or why that is not told."""
    score = np.asarray(cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED), dtype=np.float32)
    reach = score.shape[0] // 2
    row, column = divmod(int(np.argmax(score)), score.shape[1])
    best = float(score[row, column])
    # NaN, of a patch without contrast, compares false.
    if not best >= settings.correlation_min:
        return np.full(2, np.nan), "correlation"
    if row in (0, 2 * reach) or column in (0, 2 * reach):
        return np.full(2, np.nan), "search limit"
    beside = patch.shape[0] // 4
    others = score.copy()
    others[
        max(0, row - beside) : row + beside + 1, max(0, column - beside) : column + beside + 1
    ] = -1.0
    if others.max() > settings.runner_up_max * best:
        return np.full(2, np.nan), "ambiguous"
    across, down = score[row], score[:, column]
    vertex = np.array([_vertex(across, column), _vertex(down, row)])
    return vertex - reach, ""


def _vertex(score: Float32Array, peak: int) -> float:
    """Where the parabola through a peak and its two neighbours has its vertex."""
    before, at, after = (float(score[k]) for k in (peak - 1, peak, peak + 1))
    curvature = before - 2.0 * at + after
    return peak + (0.5 * (before - after) / curvature if curvature < 0.0 else 0.0)
