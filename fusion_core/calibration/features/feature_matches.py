"""Features of an intensity image matched with a camera's image (Song 2022 §2.2.1, Fig. 10): SIFT,
ratio test, and a geometric check by RANSAC."""

from typing import Literal

import cv2
import numpy as np

from fusion_core.calibration.features.feature_points import (
    has_middle_fraction,
    interpolated_points,
    nearest_points,
)
from fusion_core.calibration.features.intensity_image import IntensityImage, equalise
from fusion_core.calibration.features.matched_pairs import MatchedPairs
from fusion_core.lens.projection import project_points
from fusion_core.lens.undistortion import straight_pixels
from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray, IntArray
from fusion_core.model.geometry import transform_points
from fusion_core.model.seeds import SEED_MAX
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.settings import StageSettings, setting

_NO_DESCRIPTORS = np.empty((0, 128), dtype=np.float32)
_PNP_PAIRS, _HOMOGRAPHY_PAIRS, _FUNDAMENTAL_PAIRS = 4, 4, 8


class FeatureSettings(StageSettings):
    """Settings of ``match_features``."""

    features_max: int = setting(4000, "Most features of an image", ge=50, le=50_000)
    contrast_min: float = setting(
        0.02, "Least contrast of a feature (OpenCV's contrastThreshold)", ge=0.0, le=0.5
    )
    ratio_max: float = setting(
        0.85,
        "Ratio test: greatest distance of the best descriptor, of the second best's",
        ge=0.3,
        le=1.0,
    )
    check: Literal["pnp", "homography", "fundamental"] = setting(
        "pnp", "Geometric check by RANSAC: the pose of the 3D points, or a map of the two images"
    )
    threshold_px: float = setting(
        6.0, "RANSAC: greatest residual of an inlier", unit="px", ge=0.1, le=100.0
    )
    draws_max: int = setting(20_000, "RANSAC: most draws", ge=10, le=1_000_000)
    confidence: float = setting(
        0.999, "RANSAC: probability of a clean draw at which drawing stops", ge=0.5, le=0.99999
    )
    point: Literal["interpolated", "nearest"] = setting(
        "interpolated",
        "The 3D point of a feature: interpolated, not across a depth edge, or its pixel's, where "
        "its fraction is not in 0.3 to 0.7",
    )
    edge_fraction: float = setting(
        0.1,
        "Points around a feature that depart more from a plane lie across a depth edge",
        unit="of the depth",
        ge=0.005,
        le=1.0,
    )
    seed: int = setting(0, "Seed of the draws", ge=0, le=SEED_MAX)


PUBLISHED = FeatureSettings(ratio_max=0.8, check="homography", threshold_px=20.0, point="nearest")
"""The paper names no ratio and no threshold; 0.8 is Lowe's. Its RANSAC is of the two images."""


class Features:
    """SIFT features: ``pixels`` (N, 2) and their descriptors (N, 128)."""

    def __init__(self, picture: ByteArray, settings: FeatureSettings) -> None:
        sift = cv2.SIFT.create(
            nfeatures=settings.features_max, contrastThreshold=settings.contrast_min
        )
        keypoints, found = sift.detectAndCompute(picture, None)
        self.pixels = np.array([k.pt for k in keypoints], dtype=np.float64).reshape(-1, 2)
        # OpenCV has None for no features.
        descriptors = np.asarray(found, dtype=np.float32) if len(keypoints) else _NO_DESCRIPTORS
        # The square root of a histogram (RootSIFT): Euclidean distance is then Hellinger's.
        total = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9)
        self.descriptors = np.sqrt(descriptors / total)


def camera_features(
    grey: ByteArray, pixel_size: float, clahe_limit: float, settings: FeatureSettings
) -> Features:
    """Features of a camera's image in pixels ``pixel_size`` times as wide, at its own pixels."""
    size = (max(1, round(grey.shape[1] / pixel_size)), max(1, round(grey.shape[0] / pixel_size)))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA) if pixel_size > 1.0 else grey
    if clahe_limit > 0.0:
        small = equalise(np.asarray(small, dtype=np.uint8), clahe_limit)
    features = Features(np.asarray(small, dtype=np.uint8), settings)
    scale = np.array([grey.shape[1], grey.shape[0]]) / size if pixel_size > 1.0 else 1.0
    features.pixels = (features.pixels + 0.5) * scale - 0.5
    return features


def match_features(
    image: IntensityImage,
    camera: Features,
    intrinsics: CameraIntrinsics,
    settings: FeatureSettings,
    *,
    predicted: tuple[FloatArray, float] | None = None,
) -> MatchedPairs:
    """Pairs of an intensity image's features and a camera's.

    ``predicted``: T_camera_lidar of an initial guess and a radius in px; features farther from
    where it projects them are not compared.
    """
    seen = Features(image.picture, settings)
    possible = (
        None if predicted is None else _near_prediction(image, camera, seen, intrinsics, *predicted)
    )
    camera_index, cloud_index, is_clear = _nearest_two(camera, seen, settings.ratio_max, possible)
    image_px, intensity_px = camera.pixels[camera_index], seen.pixels[cloud_index]
    reasons = np.where(is_clear, "", "ratio").astype(object)
    if settings.point == "interpolated":
        points_m, is_edge = interpolated_points(
            image, intensity_px, radius_px=3, edge_fraction=settings.edge_fraction
        )
        reasons[(reasons == "") & is_edge] = "depth edge"
    else:
        points_m = nearest_points(image, intensity_px)
        reasons[(reasons == "") & has_middle_fraction(intensity_px)] = "pixel fraction"
    reasons[(reasons == "") & ~np.isfinite(points_m).all(axis=1)] = "no point"
    candidates = np.flatnonzero(reasons == "")
    agree = _geometric_check(
        image_px[candidates], intensity_px[candidates], points_m[candidates], intrinsics, settings
    )
    reasons[candidates[~agree]] = "RANSAC"
    return MatchedPairs(
        image_px=image_px,
        intensity_px=intensity_px,
        points_m=points_m,
        reasons=tuple(reasons.tolist()),
    )


def _nearest_two(
    camera: Features, cloud: Features, ratio_max: float, possible: BoolArray | None
) -> tuple[IntArray, IntArray, BoolArray]:
    """Index pairs of best descriptors among the (camera, cloud) ``possible`` ones, and which pass
    the ratio test."""
    if len(camera.pixels) == 0 or len(cloud.pixels) < 2:
        empty = np.empty(0, dtype=np.int64)
        return empty, empty, np.empty(0, dtype=np.bool_)
    # Distances of unit vectors, as one matrix product.
    likeness = camera.descriptors @ cloud.descriptors.T
    if possible is not None:
        likeness[~possible] = -1.0
    best = likeness.argmax(axis=1)
    rows = np.arange(len(best))
    first = likeness[rows, best].copy()
    likeness[rows, best] = -1.0
    second = likeness.max(axis=1)
    distance = np.sqrt(np.maximum(2.0 - 2.0 * np.stack([first, second]), 0.0))
    # A best likeness of -1 is none.
    is_clear = (first > 0.0) & (distance[0] <= ratio_max * distance[1])
    return rows, best, is_clear


def _near_prediction(
    image: IntensityImage,
    camera: Features,
    cloud: Features,
    intrinsics: CameraIntrinsics,
    T_camera_lidar: FloatArray,
    radius_px: float,
) -> BoolArray:
    """(camera, cloud) features that lie near where a pose projects those of the cloud."""
    points_m = nearest_points(image, cloud.pixels)
    expected = project_points(transform_points(T_camera_lidar, points_m), intrinsics)
    away = np.linalg.norm(camera.pixels[:, np.newaxis] - expected[np.newaxis], axis=2)
    # NaN, of a feature without a point, compares false.
    near: BoolArray = away <= radius_px
    return near


def _geometric_check(
    image_px: FloatArray,
    intensity_px: FloatArray,
    points_m: FloatArray,
    intrinsics: CameraIntrinsics,
    settings: FeatureSettings,
) -> BoolArray:
    """(N,) pairs that agree with the model of most support."""
    count = len(image_px)
    inliers = np.zeros(count, dtype=np.bool_)
    ideal = straight_pixels(image_px, intrinsics)
    usable = np.flatnonzero(np.isfinite(ideal).all(axis=1))
    # OpenCV's draws have a seed of their own: another order of the pairs is another sample.
    order = usable[np.random.default_rng(settings.seed).permutation(usable.size)]
    a, b = np.ascontiguousarray(ideal[order]), np.ascontiguousarray(intensity_px[order])
    least = {"pnp": _PNP_PAIRS, "homography": _HOMOGRAPHY_PAIRS, "fundamental": _FUNDAMENTAL_PAIRS}
    if order.size < least[settings.check] + 1:
        return inliers
    if settings.check == "pnp":
        found, _, _, chosen = cv2.solvePnPRansac(
            np.ascontiguousarray(points_m[order]),
            a,
            intrinsics.matrix,
            None,
            iterationsCount=settings.draws_max,
            reprojectionError=settings.threshold_px,
            confidence=settings.confidence,
            flags=cv2.SOLVEPNP_AP3P,
        )
        if found and chosen is not None:
            inliers[order[chosen.ravel()]] = True
        return inliers
    if settings.check == "homography":
        _, mask = cv2.findHomography(
            b,
            a,
            cv2.RANSAC,
            settings.threshold_px,
            maxIters=settings.draws_max,
            confidence=settings.confidence,
        )
    else:
        _, mask = cv2.findFundamentalMat(
            b, a, cv2.FM_RANSAC, settings.threshold_px, settings.confidence, settings.draws_max
        )
    if mask is not None:
        inliers[order] = mask.ravel().astype(np.bool_)
    return inliers
