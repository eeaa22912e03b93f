"""Where pictures stand in the scene: the depth image to the left, the heatmap to the right.

For the viewer behind and above the LiDAR they stand beside what the camera sees, above the curve
and before all rows, so that they can be read in any room.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import R_BODY_OPTICAL, ByteArray, FloatArray, read_only
from fusion_core.model.geometry import rotation_from_yaw_pitch_roll
from scanloom.scene.frame_geometry import FrameGeometry
from scanloom.scene.geometry import quaternion
from scanloom.scene.picking import Plane

_SMALLEST_REACH_M, _USUAL_REACH_M, _LARGEST_REACH_M = 2.0, 4.0, 12.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ImagePlane:
    """A picture, (H, W, 3) uint8, on a plane in the scene."""

    name: str
    rgb: ByteArray
    plane: Plane

    def __post_init__(self) -> None:
        if self.rgb.shape[:2] != (self.plane.height_px, self.plane.width_px):
            raise ValueError(f"a picture of {self.rgb.shape[:2]} is none of {self.plane}")
        read_only(self.rgb)

    def pixel_at(
        self, ray_origin_m: FloatArray, ray_direction: FloatArray
    ) -> tuple[float, float] | None:
        """(x_px, y_px) that a ray hits, None where it misses."""
        return self.plane.pixel_at(ray_origin_m, ray_direction)


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """How the scene of a recording is laid out, the same for all of its frames.

    ``yaw_rad``: where the rig looks in the LiDAR's frame. ``reach_m``: how far most of what is
    seen lies away.
    """

    yaw_rad: float
    reach_m: float

    def depth_plane(self, rgb: ByteArray) -> ImagePlane:
        """The depth image's image plane, to the left."""
        return self._board("depth", rgb, side=1.0)

    def heatmap_plane(self, rgb: ByteArray) -> ImagePlane:
        """The heatmap's image plane, to the right."""
        return self._board("heatmap", rgb, side=-1.0)

    def ahead(self, forward_m: float, left_m: float, up_m: float) -> FloatArray:
        """(3,) the point so far ahead, to the left and above, as the rig looks."""
        R_lidar_ahead = rotation_from_yaw_pitch_roll(self.yaw_rad, 0.0, 0.0)
        point: FloatArray = R_lidar_ahead @ np.array([forward_m, left_m, up_m])
        return point

    def _board(self, name: str, rgb: ByteArray, *, side: float) -> ImagePlane:
        height_px, width_px = rgb.shape[:2]
        width_m = self.reach_m * min(0.29, 0.26 * width_px / height_px)
        height_m = width_m * height_px / width_px
        position = self.ahead(
            0.13 * self.reach_m, side * 0.43 * self.reach_m, 0.45 * self.reach_m + 0.5 * height_m
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
    away_m = np.linalg.norm(points_m, axis=1)
    away_m = away_m[np.isfinite(away_m)]
    reach_m = float(np.percentile(away_m, 90.0)) if away_m.size else _USUAL_REACH_M
    return Layout(
        yaw_rad=yaw_rad, reach_m=float(np.clip(reach_m, _SMALLEST_REACH_M, _LARGEST_REACH_M))
    )
