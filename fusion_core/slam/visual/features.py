"""ORB features spread evenly over the image, with the depth below each."""

from collections.abc import Sequence

import cv2
import numpy as np

from fusion_core.compiled import compiled
from fusion_core.lens.undistortion import straight_pixels
from fusion_core.model.conventions import Float32Array, FloatArray, IntArray
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.motion.feature_depths import sample_depths_m
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.visual.frame_features import FrameFeatures, no_features

SCALE_FACTOR = 1.2
"""Between neighbouring levels of the pyramid, as in ORB-SLAM2."""


def octave_scales(octaves: IntArray) -> FloatArray:
    """(N,) the size of a pixel of each level, (N,), in pixels of the image."""
    scales: FloatArray = np.power(SCALE_FACTOR, octaves.astype(np.float64))
    return scales


# ORB finds this many times the corners that are kept: what is spread evenly must be chosen from.
_CANDIDATES_PER_FEATURE = 6
# Halvings of the search for the size of a cell: to a pixel in a VGA image.
_CELL_SEARCH_STEPS = 9


class FeatureSettings(StageSettings):
    """Settings of ``FeatureExtractor``."""

    features_max: int = setting(
        1000, "Most ORB features per image", unit="features", ge=50, le=20_000
    )
    levels: int = setting(8, "Levels of the image pyramid", unit="levels", ge=1, le=16)
    fast_threshold: int = setting(7, "FAST corner threshold", unit="grey levels", ge=1, le=100)
    depth_min_m: float = setting(0.2, "Least depth of a feature", unit="m", ge=1e-6, le=100.0)
    depth_max_m: float = setting(8.0, "Greatest depth of a feature", unit="m", ge=1e-6, le=100.0)


class FeatureExtractor:
    """Extracts the features of a camera's images.

    A corner is kept as the strongest of its cell; the cells are as small as the wanted number
    allows, so that a textured corner of the image does not take all features.
    """

    def __init__(self, intrinsics: CameraIntrinsics, settings: FeatureSettings) -> None:
        self._intrinsics, self._settings = intrinsics, settings
        self._orb = cv2.ORB.create(
            nfeatures=_CANDIDATES_PER_FEATURE * settings.features_max,
            scaleFactor=SCALE_FACTOR,
            nlevels=settings.levels,
            fastThreshold=settings.fast_threshold,
            scoreType=cv2.ORB_FAST_SCORE,
        )
        # Each level's part, in proportion to its side, as in ORB-SLAM2's pyramid.
        sides = SCALE_FACTOR ** -np.arange(settings.levels, dtype=np.float64)
        self._quotas = np.round(settings.features_max * sides / sides.sum()).astype(np.int64)

    def extract(self, frame: RgbdFrame) -> FrameFeatures:
        """The features of an image, by falling response within each level; none may be found."""
        found = self._orb.detect(frame.gray, None)
        pixels = _pixels_of(found)
        responses = np.array([point.response for point in found], np.float64)
        octaves = np.array([point.octave for point in found], np.int64)
        kept = self._spread_evenly(pixels, responses, octaves)
        keypoints, descriptors = self._orb.compute(frame.gray, [found[i] for i in kept.tolist()])
        if descriptors is None or not keypoints:
            return no_features()
        pixels = _pixels_of(keypoints)
        straight = straight_pixels(pixels, self._intrinsics)
        is_shown = np.isfinite(straight[:, 0])
        depths_m = sample_depths_m(frame, pixels)
        is_usable = (depths_m > self._settings.depth_min_m) & (
            depths_m < self._settings.depth_max_m
        )
        return FrameFeatures(
            pixels=straight[is_shown],
            depths_m=np.where(is_usable, depths_m, np.nan)[is_shown],
            octaves=np.array([point.octave for point in keypoints], np.int64)[is_shown],
            angles_deg=np.array([point.angle for point in keypoints], np.float32)[is_shown],
            descriptors=np.asarray(descriptors, np.uint8)[is_shown],
        )

    def _spread_evenly(
        self, pixels: Float32Array, responses: FloatArray, octaves: IntArray
    ) -> IntArray:
        """(F,) the candidates that are kept, level by level."""
        kept = []
        for octave, quota in enumerate(self._quotas.tolist()):
            of_level = np.flatnonzero(octaves == octave)
            # Ties by place, so that the order does not depend on the detector's.
            order = np.lexsort((pixels[of_level, 0], pixels[of_level, 1], -responses[of_level]))
            of_level = of_level[order]
            kept.append(of_level[spread_evenly(pixels[of_level], quota)])
        return np.concatenate(kept)


def _pixels_of(keypoints: Sequence[cv2.KeyPoint]) -> Float32Array:
    """(N, 2) places of N keypoints."""
    return np.asarray(cv2.KeyPoint.convert(keypoints), np.float32).reshape(-1, 2)


def spread_evenly(pixels: Float32Array, count: int) -> IntArray:
    """(K,) at most ``count`` of the (N, 2) pixels, which are given strongest first, ascending.

    The strongest of each square cell is kept, with the smallest cells that keep no more than
    ``count``; the rest of the count goes to the strongest of those left.
    """
    if len(pixels) <= count:
        return np.arange(len(pixels))
    low, high = 1.0, float(np.ptp(pixels, axis=0).max()) + 1.0
    kept = np.zeros(1, np.int64)
    for _ in range(_CELL_SEARCH_STEPS):
        side = 0.5 * (low + high)
        first = _first_of_cells(pixels, np.float32(side))
        if len(first) <= count:
            kept, high = first, side
        else:
            low = side
    is_left = np.ones(len(pixels), np.bool_)
    is_left[kept] = False
    rest = np.flatnonzero(is_left)[: count - len(kept)]
    return np.sort(np.concatenate([kept, rest]))


@compiled(nogil=True)
def _first_of_cells(pixels: Float32Array, side: np.float32) -> IntArray:
    """The first of the (N, 2) pixels in each square cell."""
    columns, rows = np.floor(pixels[:, 0] / side), np.floor(pixels[:, 1] / side)
    across = int(columns.max()) + 1
    is_taken = np.zeros(across * (int(rows.max()) + 1), np.bool_)
    first = np.empty(len(pixels), np.int64)
    count = 0
    for k in range(len(pixels)):
        cell = int(rows[k]) * across + int(columns[k])
        if not is_taken[cell]:
            is_taken[cell] = True
            first[count] = k
            count += 1
    return first[:count]
