"""A LiDAR curve cut from a row of the depth image, to inspect recordings with depth alone.

The curve is the row's full width, as depthimage_to_laserscan makes it. So that alignment has
offsets to search, the depth rows are then cropped to their middle, and the rows around the cut are
removed. Results are labelled virtual: both curves are from one sensor.
"""

from dataclasses import replace

import numpy as np

from fusion_core.alignment.upright import UprightView
from fusion_core.model.conventions import Float32Array
from fusion_core.model.errors import SettingsError
from fusion_core.model.rig import Camera
from fusion_core.model.sensors import DepthImage, LaserScan
from fusion_core.model.sweep import MAX_BEAMS

FRAME_ID = "virtual_lidar"
# The rows keep this fraction of their columns, so that there are offsets to search.
_KEPT_WIDTH_FRACTION = 0.6
# Rows beside the cut that show the same surface would match it trivially.
_ROWS_LEFT_OUT = 3
# The maximum range of Intel's D400 cameras, by their data sheet ("approximately 10 m").
_RANGE_MAX_M = 10.0


def cut_scan(image: DepthImage, camera: Camera, row: int) -> LaserScan:
    """The scan of an upright image's ``row``: one beam a column, on equal angles.

    Raises SettingsError for a row that the image does not have, and for images that are no sweep.
    """
    intrinsics = camera.intrinsics
    if not 0 <= row < intrinsics.height:
        raise SettingsError(
            f"--virtual-lidar {row}: the depth image has rows 0 to {intrinsics.height - 1}.",
            advice="Name one of these.",
        )
    if not 2 <= intrinsics.width <= MAX_BEAMS:
        raise SettingsError(
            f"--virtual-lidar {row}: a scan has 2 to {MAX_BEAMS} beams, a row of the depth image "
            f"{intrinsics.width} pixels.",
            advice="Use a recording with a 2D LiDAR.",
        )
    ends_rad = camera.column_azimuths_rad(np.array([0.0, intrinsics.width - 1.0]))
    azimuths_rad = np.linspace(float(ends_rad[1]), float(ends_rad[0]), intrinsics.width)
    columns = np.rint(intrinsics.cx - intrinsics.fx * np.tan(azimuths_rad)).astype(np.int64)
    columns = np.clip(columns, 0, intrinsics.width - 1)
    ranges_m = image.depth_m[row, columns].astype(np.float64) / np.cos(azimuths_rad)
    ranges_m[ranges_m > _RANGE_MAX_M] = np.nan
    return LaserScan(
        stamp_ns=image.stamp_ns,
        received_ns=image.received_ns,
        frame_id=FRAME_ID,
        angle_min_rad=float(azimuths_rad[0]),
        angle_increment_rad=float(azimuths_rad[1] - azimuths_rad[0]),
        range_min_m=0.1,
        range_max_m=_RANGE_MAX_M,
        ranges_m=ranges_m,
    )


def mask_cut_rows(depth_m: Float32Array, row: int) -> Float32Array:
    """The image without the rows around the cut (NaN there)."""
    kept = depth_m.copy()
    kept[max(0, row - _ROWS_LEFT_OUT) : row + _ROWS_LEFT_OUT + 1] = np.nan
    return kept


def crop_view(view: UprightView) -> UprightView:
    """The middle columns of a view, so that the curve is wider than the rows laid on it."""
    intrinsics = view.intrinsics
    first = round(0.5 * (1.0 - _KEPT_WIDTH_FRACTION) * intrinsics.width)
    last = intrinsics.width - first
    index = view.stored_index
    if index is None:
        index = np.arange(intrinsics.height * intrinsics.width, dtype=np.int64).reshape(
            intrinsics.height, intrinsics.width
        )
    return replace(
        view,
        intrinsics=replace(intrinsics, width=last - first, cx=intrinsics.cx - first),
        stored_index=np.ascontiguousarray(index[:, first:last]),
    )
