"""Virtual scans of Li 2022 §2.2: the camera's cloud merged with the LiDAR's scan.

The paper's six steps, and where they are:

1. subsample the camera's cloud: ``camera_points.project_to_cloud``
2. drop the floor and what is higher than the robot: ``camera_points.project_to_cloud``
3. crop the LiDAR's scan: ``merge_camera_cloud``
4. join the two clouds: ``merge_camera_cloud``
5. radius filter: ``radius_filter.has_neighbours``
6. one scan, the nearest point of each angle: ``beam_surfaces.nearest_surfaces``

A cloud here is (N, 3): x and y in the LiDAR's frame, height above the floor.

The default differs from the paper where that improves the map. Points are averages of small voxels,
not every 64th row, which misses thin furniture. The lower height limit rises with the distance: one
pixel in ten of a Kinect's floor lies 1 cm above its plane at 1 m and 5 cm at 2.5 m, and a tilt
error of half a degree lifts the floor 4 m away by 3 cm. The LiDAR keeps all its beams: its far
points are too sparse for a radius that suits the camera. The nearest of many noisy depths is biased
towards the sensor, so the range of an angle is the mean over the surface of its nearest point;
where the LiDAR measured that surface, its range is kept.

Space before the nearest point of an angle counts as free, but for cells in which something was seen
at heights that the camera does not see at that distance (``height_bands``). An angle without any
point is NaN.
"""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, Literal

import numpy as np

from fusion_core.mapping.beam_surfaces import nearest_surfaces, surfaces_behind
from fusion_core.mapping.height_bands import BeamHeights, ImageEdges, VirtualScan, seen_bands
from fusion_core.model.conventions import BoolArray, FloatArray, wrap_angle
from fusion_core.model.sensors import LaserScan
from fusion_core.registration.radius_filter import has_neighbours
from fusion_core.settings import StageSettings, setting


class VirtualScanSettings(StageSettings):
    """From depth images and scans to virtual scans (Li 2022 §2.2)."""

    sampling: Literal["voxel", "stride"] = setting(
        "voxel", "Subsample the camera's cloud by voxels, or by every k-th pixel as published"
    )
    voxel_m: float = setting(0.025, "Side of a voxel", unit="m", ge=0.005, le=0.2)
    row_stride: int = setting(64, "Every k-th row of the image, for stride", ge=1, le=65_535)
    column_stride: int = setting(4, "Every k-th column of the image, for stride", ge=1, le=65_535)
    depth_min_m: float = setting(0.3, "Least depth used", unit="m", ge=0.0, le=100.0)
    depth_max_m: float = setting(5.0, "Greatest depth used", unit="m", ge=1e-6, le=100.0)
    height_min_m: float = setting(
        0.03, "Lower height limit above the floor, at the camera", unit="m", ge=0.0, le=20.0
    )
    height_min_per_m: float = setting(
        0.01, "Rise of the lower height limit with the distance from the camera", ge=0.0, le=0.2
    )
    height_max_m: float = setting(
        0.55, "Upper height limit: the robot's own height", unit="m", ge=1e-6, le=20.0
    )
    lidar_half_width_deg: float = setting(
        180.0, "Half of the LiDAR's field of view that is kept", unit="deg", ge=1e-6, le=180.0
    )
    radius_m: float = setting(0.1, "Radius of the filter", unit="m", ge=0.001, le=0.5)
    neighbours_min: int = setting(
        10,
        "Fewest other points within the radius, or a point is dropped (0: keep all)",
        ge=0,
        le=1_000,
    )
    filter_lidar: bool = setting(False, "Apply the filter to the LiDAR's points too")
    same_surface_m: float = setting(
        0.04,
        "Points this close are one surface: the LiDAR's range is kept, depths are averaged",
        unit="m",
        ge=0.0,
        le=10.0,
    )
    same_surface_per_m2: float = setting(
        0.006, "Growth of that distance with the squared range", unit="1/m", ge=0.0, le=1.0
    )
    step_deg: float = setting(
        0.5, "Step between the beams of a scan of the camera alone", unit="deg", ge=0.05, le=5.0
    )
    max_gap_ms: float = setting(
        100.0,
        "Greatest time between a scan and the image joined to it",
        unit="ms",
        ge=1e-6,
        le=5_000.0,
    )
    layers: bool = setting(
        True, "Draw the merged map so that the camera alone clears what the LiDAR passes over"
    )
    lidar_height_m: float | None = setting(
        None,
        "The LiDAR's height above the floor; not set: from the depth's floor",
        unit="m",
        ge=1e-6,
        le=20.0,
    )

    @property
    def half_width_m(self) -> float:
        """Half of the width that a point of the cloud covers: half of a voxel's diagonal, so that
        neighbouring voxels leave no gap between them. A pixel has no width, as published."""
        return float(np.sqrt(0.5)) * self.voxel_m if self.sampling == "voxel" else 0.0


# The paper gives neither radius nor number of neighbours; these suit its sparse rows.
PUBLISHED = VirtualScanSettings(
    sampling="stride",
    depth_min_m=0.0,
    depth_max_m=8.0,
    height_min_m=0.01,
    height_min_per_m=0.0,
    lidar_half_width_deg=45.0,
    radius_m=0.1,
    neighbours_min=2,
    filter_lidar=True,
    same_surface_m=0.0,
    same_surface_per_m2=0.0,
    layers=False,
)


def merge_camera_cloud(
    scan: LaserScan,
    cloud_m: FloatArray,
    settings: VirtualScanSettings,
    lidar_height_m: float | None = None,
    cameras: Sequence[ImageEdges] = (),
) -> VirtualScan:
    """The LiDAR's scan with the obstacles that only the camera saw, at the LiDAR's own angles.

    ``cloud_m``: (N, 3) as above, at the scan's stamp. ``lidar_height_m``: the LiDAR's plane above
    the floor; None where unknown: the filter then treats the two clouds separately. ``cameras``:
    whose cloud it is; without them the scan knows no heights.

    A range beyond ``range_max_m`` (a beam without a return) is kept unless the camera saw something
    nearer. ``intensities`` are 1 where the camera saw something in a beam's angle, else 0.
    """
    angles_rad = scan.angles_rad
    ranges_m = scan.ranges_m.copy()
    # 3) The paper's crop to the front.
    ranges_m[np.abs(wrap_angle(angles_rad)) > np.deg2rad(settings.lidar_half_width_deg)] = np.nan
    beams = np.flatnonzero(ranges_m <= scan.range_max_m)
    azimuths_rad, reached_m = angles_rad[beams], ranges_m[beams]
    lidar_m = np.empty((beams.size, 3))
    lidar_m[:, 0] = reached_m * np.cos(azimuths_rad)
    lidar_m[:, 1] = reached_m * np.sin(azimuths_rad)
    lidar_m[:, 2] = 0.0 if lidar_height_m is None else lidar_height_m
    # 4), 5)
    kept, kept_lidar = _filter_by_radius(cloud_m, lidar_m, lidar_height_m is not None, settings)
    ranges_m[beams[~kept_lidar]] = np.nan
    cloud_m = cloud_m[kept]
    # 6)
    seen_m, seen_heights_m = _nearest_on_scan(scan, cloud_m, settings)
    known = _is_seen_by_lidar(cloud_m, lidar_m[kept_lidar], settings)
    added_m, added_heights_m = _nearest_on_scan(scan, cloud_m[~known], settings)
    # Where the nearest surface that the camera saw was measured by the LiDAR, points behind it are
    # dropped; a beam without a return takes that surface's range from the camera.
    met = ranges_m <= scan.range_max_m
    limit_m = settings.same_surface_m + settings.same_surface_per_m2 * seen_m**2
    added_m[added_m > seen_m + limit_m] = np.nan
    own_m = ranges_m
    ranges_m = np.fmin(ranges_m, np.where(met, added_m, seen_m))
    heights_m = np.where((met & (ranges_m < own_m))[:, None], added_heights_m, seen_heights_m)
    # Where the LiDAR's return stays it shows its own plane, too.
    if lidar_height_m is not None:
        stays = ranges_m == own_m
        apart = stays & ~(np.abs(own_m - seen_m) <= limit_m)
        heights_m[apart] = lidar_height_m
        heights_m[stays, 0] = np.minimum(heights_m[stays, 0], lidar_height_m)
        heights_m[stays, 1] = np.maximum(heights_m[stays, 1], lidar_height_m)
    merged = scan.with_ranges(ranges_m, np.isfinite(seen_m).astype(np.float64))
    heights = _beam_heights(cameras, merged, heights_m, cloud_m[~known], settings)
    return VirtualScan(**_values_of(merged), heights=heights)


def _values_of(scan: LaserScan) -> dict[str, Any]:
    return {field.name: getattr(scan, field.name) for field in fields(LaserScan)}


def _beam_heights(
    cameras: Sequence[ImageEdges],
    scan: LaserScan,
    surfaces_m: FloatArray,
    cloud_m: FloatArray,
    settings: VirtualScanSettings,
) -> BeamHeights | None:
    """``surfaces_m``: of what ends the scan's beams. ``cloud_m``: where to look for more behind."""
    if not cameras:
        return None
    lower, upper = seen_bands(
        cameras,
        scan.angles_rad,
        lowest=(settings.height_min_m, settings.height_min_per_m),
        highest_m=settings.height_max_m,
    )
    behind_m, behind_surfaces_m = surfaces_behind(
        cloud_m, scan, _surface_thickness_m(cloud_m, settings)
    )
    return BeamHeights(
        surfaces_m=surfaces_m,
        lower=lower,
        upper=upper,
        behind_m=behind_m,
        behind_surfaces_m=behind_surfaces_m,
    )


def _nearest_on_scan(
    scan: LaserScan, cloud_m: FloatArray, settings: VirtualScanSettings
) -> tuple[FloatArray, FloatArray]:
    """``nearest_surfaces`` of the camera's points, at a scan's angles and within its range."""
    nearest_m, heights_m = nearest_surfaces(
        cloud_m,
        scan.angle_min_rad,
        scan.angle_increment_rad,
        scan.ranges_m.size,
        half_width_m=settings.half_width_m,
        thickness_m=_surface_thickness_m(cloud_m, settings),
    )
    beyond = nearest_m > scan.range_max_m
    nearest_m[beyond], heights_m[beyond] = np.nan, np.nan
    return nearest_m, heights_m


def make_camera_scan(
    cloud_m: FloatArray,
    settings: VirtualScanSettings,
    *,
    stamp_ns: int,
    received_ns: int | None,
    frame_id: str,
    cameras: Sequence[ImageEdges] = (),
) -> VirtualScan:
    """The scan of the camera alone, all around with a step of about ``step_deg``.

    ``cloud_m``: (N, 3) as above. Angles in which the camera saw nothing are NaN. ``cameras``: whose
    cloud it is; without them the scan knows no heights.
    """
    beams = round(360.0 / settings.step_deg)
    increment_rad = 2.0 * np.pi / beams
    kept = has_neighbours(cloud_m, cloud_m, settings.radius_m, settings.neighbours_min)
    cloud_m = cloud_m[kept]
    ranges_m, heights_m = nearest_surfaces(
        cloud_m,
        -np.pi,
        increment_rad,
        beams,
        half_width_m=settings.half_width_m,
        thickness_m=_surface_thickness_m(cloud_m, settings),
    )
    # Away from the optical axis a point's distance exceeds its depth.
    range_max_m = 2.0 * settings.depth_max_m
    ranges_m[ranges_m > range_max_m] = np.nan
    scan = LaserScan(
        stamp_ns=stamp_ns,
        received_ns=received_ns,
        frame_id=frame_id,
        angle_min_rad=-np.pi,
        angle_increment_rad=increment_rad,
        range_min_m=0.0,
        range_max_m=range_max_m,
        ranges_m=ranges_m,
    )
    heights = _beam_heights(cameras, scan, heights_m, cloud_m, settings)
    return VirtualScan(**_values_of(scan), heights=heights)


def _surface_thickness_m(cloud_m: FloatArray, settings: VirtualScanSettings) -> FloatArray:
    """(N,) spread of one surface's depths at the distance of each point."""
    squared_m2 = cloud_m[:, 0] ** 2 + cloud_m[:, 1] ** 2
    return settings.same_surface_m + settings.same_surface_per_m2 * squared_m2


def _filter_by_radius(
    cloud_m: FloatArray, lidar_m: FloatArray, same_heights: bool, settings: VirtualScanSettings
) -> tuple[BoolArray, BoolArray]:
    """Which points of camera and LiDAR have neighbours in the joined cloud."""
    radius_m, least = settings.radius_m, settings.neighbours_min
    joined_m = np.concatenate([cloud_m, lidar_m])
    kept = has_neighbours(cloud_m, joined_m if same_heights else cloud_m, radius_m, least)
    if not settings.filter_lidar:
        return kept, np.ones(len(lidar_m), dtype=np.bool_)
    return kept, has_neighbours(lidar_m, joined_m if same_heights else lidar_m, radius_m, least)


def _is_seen_by_lidar(
    cloud_m: FloatArray, lidar_m: FloatArray, settings: VirtualScanSettings
) -> BoolArray:
    """(N,) which points of the camera the LiDAR has measured already, seen from above."""
    from scipy.spatial import cKDTree

    limit_m = _surface_thickness_m(cloud_m, settings)
    if not len(lidar_m) or not limit_m.any():
        return np.zeros(len(cloud_m), dtype=np.bool_)
    farthest_m = np.nextafter(limit_m.max(), np.inf)
    distance_m, _ = cKDTree(lidar_m[:, :2]).query(cloud_m[:, :2], distance_upper_bound=farthest_m)
    on_surface: BoolArray = distance_m <= limit_m
    return on_surface
