"""The LiDAR's curve in a camera's upright image at any pose of the camera, and how well the two
agree: what a person sees and counts while adjusting the pose.

Unlike the pairs of the chain, nothing is fitted here: no frame's own turn, no transform A.
"""

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np

from fusion_core.alignment.mount_settings import MountSettings
from fusion_core.alignment.scan_motion import estimate_motion
from fusion_core.lens.projection import inside_image
from fusion_core.model.conventions import (
    NS_PER_S,
    BoolArray,
    Float32Array,
    FloatArray,
    read_only,
)
from fusion_core.model.geometry import invert_transform, transform_points
from fusion_core.model.rig import Camera, Mount
from fusion_core.workflows.fuse.align import T_lidar_camera_at
from fusion_core.workflows.fuse.pairing import PairedImage
from fusion_core.workflows.fuse.session import Session

# Nearer to the camera's plane a point has no pixel.
_MIN_DEPTH_M = 0.05


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenScan:
    """A scan and the depth image that was taken with it. ``points_m``: (N, 3) the ends of the beams
    that have one, in the LiDAR's frame at the scan's stamp; ``depth_m``: (H, W) the upright view of
    camera ``camera``; ``moved``: (3,) pose of the LiDAR at the image's stamp in that frame."""

    camera: int
    points_m: FloatArray
    depth_m: Float32Array
    moved: FloatArray

    def __post_init__(self) -> None:
        read_only(self.points_m)
        read_only(self.moved)


def seen_scan(session: Session, paired: PairedImage) -> SeenScan | None:
    """The scan of an image, None where none is near enough."""
    if paired.window is None:
        return None
    scan, time = paired.window.scan, session.settings.time
    has_end = np.isfinite(scan.ranges_m)
    azimuth_rad, range_m = scan.angles_rad[has_end], scan.ranges_m[has_end]
    motion = estimate_motion(paired.window, time) if time.compensate_motion else None
    return SeenScan(
        camera=paired.camera,
        points_m=np.stack(
            [range_m * np.cos(azimuth_rad), range_m * np.sin(azimuth_rad), 0.0 * range_m], axis=1
        ),
        depth_m=session.depth_of(paired.camera, paired.image.depth_m),
        moved=np.zeros(3) if motion is None else motion.pose_after(paired.gap_ns / NS_PER_S),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CurveInImage:
    """The N points of a scan that lie in the image, hidden behind something there or not.

    ``pixels``: (N, 2) column and row in the upright view, in which pixel centres are integers.
    ``range_m``: (N,) from the LiDAR. ``difference_m``: (N,) depth of the image there minus that of
    the point, NaN where the image has none. ``agrees``: (N,) whether it is within the mount's
    tolerance.
    """

    pixels: FloatArray
    range_m: FloatArray
    difference_m: FloatArray
    agrees: BoolArray

    def __post_init__(self) -> None:
        for field in fields(self):
            read_only(getattr(self, field.name))


def curve_in_image(
    seen: SeenScan, camera: Camera, mount: Mount, settings: MountSettings
) -> CurveInImage:
    """Where the points of a scan are in its image by a mount."""
    T_camera_lidar = invert_transform(T_lidar_camera_at(camera, mount, seen.moved))
    in_camera_m = transform_points(T_camera_lidar, seen.points_m)
    intrinsics = camera.intrinsics
    z_m = np.where(in_camera_m[:, 2] > _MIN_DEPTH_M, in_camera_m[:, 2], np.nan)
    u = intrinsics.cx + intrinsics.fx * in_camera_m[:, 0] / z_m
    v = intrinsics.cy + intrinsics.fy * in_camera_m[:, 1] / z_m
    pixels = np.stack([u, v], axis=1)
    inside = inside_image(pixels, intrinsics)
    pixels, range_m = pixels[inside], np.hypot(*seen.points_m[inside, :2].T)
    column, row = np.rint(pixels.T).astype(np.int64)
    difference_m = seen.depth_m[row, column].astype(np.float64) - z_m[inside]
    tolerance_m = settings.tolerance_m + settings.tolerance_fraction * range_m
    with np.errstate(invalid="ignore"):
        agrees = np.abs(difference_m) <= tolerance_m
    return CurveInImage(pixels=pixels, range_m=range_m, difference_m=difference_m, agrees=agrees)


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveAgreement:
    """How many of the LiDAR's points in ``frames`` images agree with the depth there.

    ``in_image``: points in an image; ``on_depth``: those where it has depth; ``agreeing``: those
    within the tolerance. ``median_m``: of the differences' magnitudes, NaN without any.
    """

    frames: int
    in_image: int
    on_depth: int
    agreeing: int
    median_m: float

    @property
    def fraction(self) -> float:
        """Of the points on depth those that agree, NaN without any."""
        return self.agreeing / self.on_depth if self.on_depth else float("nan")


def curve_agreement(curves: Iterable[CurveInImage]) -> CurveAgreement:
    """The agreement over several images."""
    each = list(curves)
    differences_m = np.concatenate([np.empty(0), *(np.abs(one.difference_m) for one in each)])
    known_m = differences_m[np.isfinite(differences_m)]
    return CurveAgreement(
        frames=len(each),
        in_image=differences_m.size,
        on_depth=known_m.size,
        agreeing=sum(int(one.agrees.sum()) for one in each),
        median_m=float(np.median(known_m)) if known_m.size else float("nan"),
    )
