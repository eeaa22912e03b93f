"""A pair of scan and depth image as the mount's refinement keeps it."""

from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import NS_PER_S, Float32Array, FloatArray, read_only
from fusion_core.model.polar import points_from_polar
from fusion_core.model.rig import Camera
from fusion_core.model.sensors import LaserScan


@dataclass(frozen=True, slots=True, kw_only=True)
class MountObservation:
    """A paired scan and image of the subset that the refinement uses.

    ``points_m``: (N, 2) valid LiDAR points in the LiDAR frame at the scan's stamp, or of a scan
    that is interpolated nearer to the image. ``raw_depth_m``: (H, W) upright view, ``depth_m`` the
    same without speckle. ``image_after_scan_s``, ``image_after_points_s``: image stamp - the stamp
    of the scan, and of the points.
    """

    camera: Camera
    scan: LaserScan
    raw_depth_m: Float32Array
    points_m: FloatArray
    depth_m: Float32Array
    turn_rate_rad_s: float
    image_after_scan_s: float
    image_after_points_s: float

    def __post_init__(self) -> None:
        read_only(self.points_m)
        read_only(self.depth_m)


def mount_observation(
    camera: Camera,
    scan: LaserScan,
    depth_m: Float32Array,
    image_stamp_ns: int,
    turn_rate_rad_s: float,
    aligned_scan: LaserScan | None = None,
) -> MountObservation:
    """The observation of one pair. ``turn_rate_rad_s`` is NaN where the scan has no neighbours in
    time; the turn between the two stamps is then not compensated. ``aligned_scan``: the one that
    gives the points, where it is another."""
    source = scan if aligned_scan is None else aligned_scan
    valid = np.isfinite(source.ranges_m)
    return MountObservation(
        camera=camera,
        scan=scan,
        raw_depth_m=depth_m,
        points_m=points_from_polar(source.ranges_m[valid], source.angles_rad[valid]),
        depth_m=remove_speckle(depth_m),
        turn_rate_rad_s=turn_rate_rad_s if np.isfinite(turn_rate_rad_s) else 0.0,
        image_after_scan_s=(image_stamp_ns - scan.stamp_ns) / NS_PER_S,
        image_after_points_s=(image_stamp_ns - source.stamp_ns) / NS_PER_S,
    )


def remove_speckle(depth_m: Float32Array) -> Float32Array:
    """The depth image without lone values, by a 3 x 3 median, and without lone holes.

    A hole among at least four valid pixels of one surface in the 5 x 5 around becomes their mean
    (dark furniture may return every other pixel only); other holes stay.
    """
    zeroed = np.where(np.isfinite(depth_m), depth_m, np.float32(0.0))
    filtered = cv2.medianBlur(zeroed, 3)
    square = np.ones((5, 5), dtype=np.uint8)
    valid = (zeroed > 0.0).astype(np.float32)
    count = cv2.boxFilter(valid, -1, (5, 5), normalize=False)
    total = cv2.boxFilter(zeroed, -1, (5, 5), normalize=False)
    highest = cv2.dilate(zeroed, square)
    lowest = cv2.erode(np.where(valid > 0.0, zeroed, np.float32(1e6)), square)
    mean = total / np.maximum(count, 1.0)
    one_surface = (count >= 4.0) & (highest - lowest < 0.05 * mean)
    filled = np.where((filtered <= 0.0) & one_surface, mean, filtered)
    return np.where(filled > 0.0, filled, np.float32(np.nan)).astype(np.float32)
