"""The image planes of the scene: the depth image to the left, the heatmap to the right.

Seen from behind and above the LiDAR, they flank the camera's field of view, above the LiDAR curve
and in front of all depth rows, so that nothing occludes them.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import R_BODY_OPTICAL, ByteArray, FloatArray, read_only
from fusion_core.model.geometry import rotation_from_yaw_pitch_roll
from scanloom.scene.frame_geometry import FrameGeometry
from scanloom.scene.geometry import quaternion
from scanloom.scene.picking import Plane

# Set by hand for rooms; the default is for frames without a point.
_MIN_VIEW_RANGE_M, _DEFAULT_VIEW_RANGE_M, _MAX_VIEW_RANGE_M = 2.0, 4.0, 12.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ImagePlane:
    """A picture, (H, W, 3) uint8, on a plane in the scene."""

    name: str
    rgb: ByteArray
    plane: Plane

    def __post_init__(self) -> None:
        if self.rgb.shape[:2] != (self.plane.height_px, self.plane.width_px):
            raise ValueError(f"a picture of {self.rgb.shape[:2]} does not fit {self.plane}")
        read_only(self.rgb)

    def pixel_at(
        self, ray_origin_m: FloatArray, ray_direction: FloatArray
    ) -> tuple[float, float] | None:
        """(x_px, y_px) that a ray hits, None where it misses."""
        return self.plane.pixel_at(ray_origin_m, ray_direction)


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """How the scene of a recording is laid out, the same for all of its frames.

    ``yaw_rad``: the camera's heading in the LiDAR frame. ``view_range_m``: within it are 90 % of
    the points.
    """

    yaw_rad: float
    view_range_m: float

    def depth_plane(self, rgb: ByteArray) -> ImagePlane:
        """The depth image's image plane, to the left."""
        return self._image_plane("depth", rgb, side=1.0)

    def heatmap_plane(self, rgb: ByteArray) -> ImagePlane:
        """The heatmap's image plane, to the right."""
        return self._image_plane("heatmap", rgb, side=-1.0)

    def ahead(self, forward_m: float, left_m: float, up_m: float) -> FloatArray:
        """(3,) a point given relative to the camera's heading, in the LiDAR frame."""
        R_lidar_ahead = rotation_from_yaw_pitch_roll(self.yaw_rad, 0.0, 0.0)
        point: FloatArray = R_lidar_ahead @ np.array([forward_m, left_m, up_m])
        return point

    def _image_plane(self, name: str, rgb: ByteArray, *, side: float) -> ImagePlane:
        height_px, width_px = rgb.shape[:2]
        width_m = self.view_range_m * min(0.29, 0.26 * width_px / height_px)
        height_m = width_m * height_px / width_px
        position = self.ahead(
            0.13 * self.view_range_m,
            side * 0.43 * self.view_range_m,
            0.45 * self.view_range_m + 0.5 * height_m,
        )
        turn_rad = self.yaw_rad + side * np.deg2rad(20.0)
        wxyz = quaternion(rotation_from_yaw_pitch_roll(turn_rad, 0.0, 0.0) @ R_BODY_OPTICAL)
        plane = Plane(
            width_m=width_m,
            width_px=width_px,
            height_px=height_px,
            wxyz=(float(wxyz[0]), float(wxyz[1]), float(wxyz[2]), float(wxyz[3])),
            position_m=(float(position[0]), float(position[1]), float(position[2])),
        )
        return ImagePlane(name=name, rgb=rgb, plane=plane)


def layout_of(geometry: FrameGeometry, yaw_rad: float) -> Layout:
    """The layout in which a frame fills the view. ``yaw_rad``: the mount's."""
    points_m = geometry.rows_m[:, 0] if len(geometry.rows_m) else geometry.beams_m
    distances_m = np.linalg.norm(points_m, axis=1)
    distances_m = distances_m[np.isfinite(distances_m)]
    view_range_m = (
        float(np.percentile(distances_m, 90.0)) if distances_m.size else _DEFAULT_VIEW_RANGE_M
    )
    return Layout(
        yaw_rad=yaw_rad,
        view_range_m=float(np.clip(view_range_m, _MIN_VIEW_RANGE_M, _MAX_VIEW_RANGE_M)),
    )
