"""A pair of scan and depth image as the mount's refinement keeps it."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from fusion_core.alignment.scan_motion import ScanMotion
from fusion_core.compiled import compiled
from fusion_core.model.conventions import (
    NS_PER_S,
    ByteArray,
    Float32Array,
    FloatArray,
    read_only,
)
from fusion_core.model.polar import points_from_polar
from fusion_core.model.rig import Camera
from fusion_core.model.sensors import LaserScan


@dataclass(frozen=True, slots=True, kw_only=True)
class MountObservation:
    """A paired scan and image of the subset that the refinement uses.

    ``points_m``: (N, 2) valid LiDAR points in the LiDAR frame at the scan's stamp, or of a scan
    that is interpolated nearer to the image. ``raw_depth_m``: (H, W) upright view, ``depth_m`` the
    same without speckle. ``motion``: of the LiDAR around the scan, None where it is unknown: it is
    then not compensated between the stamps. ``image_after_scan_s``, ``image_after_points_s``:
    image stamp - the stamp of the scan, and of the points.
    """

    camera: Camera
    scan: LaserScan
    raw_depth_m: Float32Array
    points_m: FloatArray
    depth_m: Float32Array
    motion: ScanMotion | None
    image_after_scan_s: float
    image_after_points_s: float

    def __post_init__(self) -> None:
        read_only(self.points_m)
        read_only(self.depth_m)

    def rolled(self, roll_rad: float) -> "MountObservation":
        """The same with the camera of a rolled rig."""
        return replace(self, camera=self.camera.rolled(roll_rad))


def mount_observation(
    camera: Camera,
    scan: LaserScan,
    depth_m: Float32Array,
    image_stamp_ns: int,
    motion: ScanMotion | None,
    aligned_scan: LaserScan | None = None,
) -> MountObservation:
    """The observation of one pair. ``aligned_scan``: the one that gives the points, where it is
    another."""
    source = scan if aligned_scan is None else aligned_scan
    valid = np.isfinite(source.ranges_m)
    return MountObservation(
        camera=camera,
        scan=scan,
        raw_depth_m=depth_m,
        points_m=points_from_polar(source.ranges_m[valid], source.angles_rad[valid]),
        depth_m=remove_speckle(depth_m),
        motion=motion,
        image_after_scan_s=(image_stamp_ns - scan.stamp_ns) / NS_PER_S,
        image_after_points_s=(image_stamp_ns - source.stamp_ns) / NS_PER_S,
    )


def remove_speckle(depth_m: Float32Array) -> Float32Array:
    """The depth image without lone values, by a 3 x 3 median, and without lone holes.

    A hole among at least four valid pixels of one surface in the 5 x 5 around becomes their mean
    (dark furniture may return every other pixel only); other holes stay.
    """
    zeroed, valid = _zero_holes(depth_m)
    filtered = cv2.medianBlur(zeroed, 3)
    count = cv2.boxFilter(valid, -1, (5, 5), normalize=False)
    # Beyond its border the image is mirrored, as it is for the count.
    padded = cv2.copyMakeBorder(zeroed, 2, 2, 2, 2, cv2.BORDER_REFLECT_101)
    cleaned: Float32Array = _fill_lone_holes(filtered, padded, count)
    return cleaned


@compiled()
def _zero_holes(depth_m: Float32Array) -> tuple[Float32Array, ByteArray]:
    """(H, W) depths with 0 for holes, and 1 where there is a depth, else 0."""
    zeroed = np.empty(depth_m.shape, dtype=np.float32)
    valid = np.empty(depth_m.shape, dtype=np.uint8)
    for row in range(depth_m.shape[0]):
        source, out, has_depth = depth_m[row], zeroed[row], valid[row]
        for column in range(source.size):
            value = source[column] if np.isfinite(source[column]) else np.float32(0.0)
            out[column] = value
            has_depth[column] = value > 0.0
    return zeroed, valid


@compiled()
def _fill_lone_holes(
    filtered: Float32Array, padded: Float32Array, count: ByteArray
) -> Float32Array:
    """(H, W) ``filtered`` with its holes, where there are enough valid pixels of one surface
    around, as the mean of those, and NaN in the others. ``padded``: (H + 4, W + 4) all pixels, 0
    for holes. ``count``: valid ones of the 5 x 5."""
    height, width = filtered.shape
    out = np.empty(filtered.shape, dtype=np.float32)
    for row in range(height):
        for column in range(width):
            value = filtered[row, column]
            if value > 0.0:
                out[row, column] = value
                continue
            out[row, column] = np.nan
            if count[row, column] < 4:
                continue
            total = 0.0
            lowest, highest = np.float32(np.inf), np.float32(0.0)
            for r in range(row, row + 5):
                for near in padded[r, column : column + 5]:
                    total += near
                    lowest = min(lowest, near if near > 0.0 else np.float32(np.inf))
                    highest = max(highest, near)
            mean = np.float32(np.float32(total) / np.float32(count[row, column]))
            if highest - lowest < np.float32(0.05) * mean:
                out[row, column] = mean
    return out
