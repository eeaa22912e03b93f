"""What the pairs of a beam and a pixel in samples.parquet are in truth.

A *good pair* is good in truth on both sides, with true horizontal ranges, both seen from the
LiDAR's origin, that differ by less than 10 cm; a *conflict pair* is the same with ranges that
differ by 10 cm or more; a *noise pair* has a value on both sides and a burr in truth on at least
one.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from fusion_core.evaluation.associated_truth import SAME_SURFACE_M, AssociatedTruth
from fusion_core.evaluation.fuse_folder import Samples
from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import ByteArray, FloatArray, IntArray


class PairKind(IntEnum):
    """What a pair is in truth. A pair with a hole on either side, or without truth, is OTHER."""

    OTHER = -1
    GOOD = 0
    CONFLICT = 1
    LIDAR_BURR = 2
    DEPTH_BURR = 3
    BURRS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class TruePairs:
    """The truth of the paired rows of some samples, (n,) each.

    ``kind``: codes of PairKind. ``image``: position of the depth image in its camera's truth.
    ``depth_true``: true class of the pixel.
    """

    kind: IntArray
    image: IntArray
    depth_true: ByteArray


def true_pairs(samples: Samples, associated: AssociatedTruth) -> TruePairs:
    """Look up both sides of each row of ``samples.paired``, in that order."""
    row = samples.paired
    scan = associated.scan_index(samples.scan_stamp_ns[row])
    beam = samples.lidar_beam[row]
    lidar_true = associated.truth.kind[scan, beam]
    lidar_range_m = associated.truth.range_m[scan, beam]
    image = associated.image_index(samples.camera[row], samples.stamp_ns[row])
    depth_true = np.zeros(row.shape, dtype=np.uint8)
    depth_range_m = np.full(row.shape, np.nan)
    for code, camera in enumerate(associated.cameras):
        mine = samples.camera[row] == code
        pixel = image[mine], samples.depth_row[row][mine], samples.depth_column[row][mine]
        depth_true[mine] = camera.truth.kind[pixel]
        depth_range_m[mine] = camera.horizontal_range_m(
            pixel[1], pixel[2], camera.truth.depth_m(*pixel)
        )
    return TruePairs(
        kind=_pair_kinds(lidar_true, depth_true, lidar_range_m - depth_range_m),
        image=image,
        depth_true=depth_true,
    )


def _pair_kinds(lidar_true: ByteArray, depth_true: ByteArray, difference_m: FloatArray) -> IntArray:
    lidar_burr = lidar_true == NoiseClass.BURR
    depth_burr = depth_true == NoiseClass.BURR
    lidar_good = lidar_true == NoiseClass.GOOD
    depth_good = depth_true == NoiseClass.GOOD
    both_good = lidar_good & depth_good
    near = np.abs(difference_m) < SAME_SURFACE_M
    far = np.abs(difference_m) >= SAME_SURFACE_M  # Both are false where truth has no value.
    kinds: IntArray = np.select(
        [
            both_good & near,
            both_good & far,
            lidar_burr & depth_good,
            lidar_good & depth_burr,
            lidar_burr & depth_burr,
        ],
        [
            PairKind.GOOD,
            PairKind.CONFLICT,
            PairKind.LIDAR_BURR,
            PairKind.DEPTH_BURR,
            PairKind.BURRS,
        ],
        PairKind.OTHER,
    )
    return kinds
