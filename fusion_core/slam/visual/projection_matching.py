"""Landmarks matched to the features near where they are expected, by descriptor."""

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray, IntArray
from fusion_core.slam.visual.features import SCALE_FACTOR
from fusion_core.slam.visual.frame_features import FrameFeatures

# Side of a cell of the grid in which features are looked up.
_CELL_PX = 16
DISTANCE_HIGH = 100
"""Of 256 bits: the largest Hamming distance of a match near an expected place (ORB-SLAM2)."""
DISTANCE_LOW = 50
"""The largest without an expected place."""


class FeatureGrid:
    """The features of an image by their place."""

    def __init__(self, features: FrameFeatures) -> None:
        self.features = features
        pixels = np.floor(features.pixels / _CELL_PX).astype(np.int64)
        # Undistorted pixels may lie outside the image.
        self._origin = pixels.min(axis=0) if len(pixels) else np.zeros(2, np.int64)
        cells = pixels - self._origin
        sizes: IntArray = cells.max(axis=0) + 1 if len(cells) else np.ones(2, np.int64)
        self._columns, self._rows = int(sizes[0]), int(sizes[1])
        flat = cells[:, 1] * self._columns + cells[:, 0]
        self._order: IntArray = np.argsort(flat, kind="stable")
        counts = np.bincount(flat, minlength=self._columns * self._rows)
        self._starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        self._words = descriptor_words(features.descriptors)

    def match(
        self,
        pixels: FloatArray,
        radii_px: FloatArray,
        octaves_min: IntArray,
        octaves_max: IntArray,
        descriptors: ByteArray,
        *,
        distance_max: int = DISTANCE_HIGH,
        ratio_max: float = 1.0,
        is_free: BoolArray | None = None,
    ) -> IntArray:
        """(N,) the feature of each of N landmarks, -1 for none.

        ``pixels``: (N, 2) where each is expected, ``radii_px``: (N,) how far off at most, on levels
        from ``octaves_min`` to ``octaves_max``, (N,). ``descriptors``: (N, 32). ``ratio_max``: of
        the distance of the best to that of the second best of the same level. ``is_free``: (F,) the
        features that may be taken. A feature is given to the landmark nearest by descriptor.
        """
        features = self.features
        if not len(features) or not len(pixels):
            return np.full(len(pixels), -1, np.int64)
        free = np.ones(len(features), np.bool_) if is_free is None else is_free
        found, distances = _nearest_features(
            # Copied: for arrays that are read-only it would be compiled once more.
            np.array(pixels, np.float64, order="C"),
            np.array(radii_px, np.float64, order="C"),
            octaves_min,
            octaves_max,
            descriptor_words(descriptors),
            features.pixels,
            features.octaves,
            self._words,
            free,
            self._origin,
            self._columns,
            self._rows,
            self._order,
            self._starts,
            float(_CELL_PX),
            distance_max,
            ratio_max,
        )
        return _one_each(found, distances, len(features))


def descriptor_words(descriptors: ByteArray) -> np.ndarray:
    """(N, 4) uint64 of (N, 32) bytes."""
    return np.ascontiguousarray(descriptors).view(np.uint64).reshape(-1, 4)


def predict_octaves(ranges_at_zero_m: FloatArray, depths_m: FloatArray, levels: int) -> IntArray:
    """(N,) the level on which a landmark at ``depths_m`` is expected.

    ``ranges_at_zero_m``: (N,) the distance at which it is seen on the finest level.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        level = np.log(ranges_at_zero_m / depths_m) / np.log(SCALE_FACTOR)
    level = np.nan_to_num(level, nan=0.0, posinf=levels, neginf=0.0)
    octaves: IntArray = np.clip(np.rint(level), 0, levels - 1).astype(np.int64)
    return octaves


@compiled(nogil=True)
def hamming(a: np.ndarray, b: np.ndarray) -> np.int64:
    """Bits in which two descriptors of four words differ."""
    total = np.int64(0)
    for k in range(4):
        x = a[k] ^ b[k]
        x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
        x = (x & np.uint64(0x3333333333333333)) + (
            (x >> np.uint64(2)) & np.uint64(0x3333333333333333)
        )
        x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
        total += np.int64((x * np.uint64(0x0101010101010101)) >> np.uint64(56))
    return total


@compiled(nogil=True)
def _nearest_features(
    pixels: FloatArray,
    radii: FloatArray,
    octaves_min: IntArray,
    octaves_max: IntArray,
    words: np.ndarray,
    feature_pixels: FloatArray,
    feature_octaves: IntArray,
    feature_words: np.ndarray,
    free: BoolArray,
    origin: IntArray,
    columns: int,
    rows: int,
    order: IntArray,
    starts: IntArray,
    cell: float,
    distance_max: int,
    ratio_max: float,
) -> tuple[IntArray, IntArray]:
    count = len(pixels)
    found = np.full(count, -1, np.int64)
    distances = np.full(count, 257, np.int64)
    for i in range(count):
        u, v, radius = pixels[i, 0], pixels[i, 1], radii[i]
        if not (np.isfinite(u) and np.isfinite(v)):
            continue
        left = max(int(np.floor((u - radius) / cell)) - origin[0], 0)
        right = min(int(np.floor((u + radius) / cell)) - origin[0], columns - 1)
        top = max(int(np.floor((v - radius) / cell)) - origin[1], 0)
        bottom = min(int(np.floor((v + radius) / cell)) - origin[1], rows - 1)
        best, second, best_octave, second_octave, best_feature = 257, 257, -1, -2, -1
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                at = row * columns + column
                for k in range(starts[at], starts[at + 1]):
                    j = order[k]
                    octave = feature_octaves[j]
                    if not free[j] or octave < octaves_min[i] or octave > octaves_max[i]:
                        continue
                    du, dv = feature_pixels[j, 0] - u, feature_pixels[j, 1] - v
                    if du * du + dv * dv > radius * radius:
                        continue
                    distance = hamming(words[i], feature_words[j])
                    if distance < best:
                        second, second_octave = best, best_octave
                        best, best_octave, best_feature = distance, octave, j
                    elif distance < second:
                        second, second_octave = distance, octave
        if best > distance_max:
            continue
        if best_octave == second_octave and best > ratio_max * second:
            continue
        found[i], distances[i] = best_feature, best
    return found, distances


def _one_each(found: IntArray, distances: IntArray, features: int) -> IntArray:
    """Each feature is kept by the nearest of the landmarks that found it, the first of equals."""
    matched = np.flatnonzero(found >= 0)
    order = matched[np.argsort(distances[matched], kind="stable")]
    _, first = np.unique(found[order], return_index=True)
    result = np.full(len(found), -1, np.int64)
    kept = order[first]
    result[kept] = found[kept]
    return result
