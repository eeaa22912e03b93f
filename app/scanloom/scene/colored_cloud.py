"""A cloud in the colours of a camera, in a browser's scene."""

import numpy as np
import viser

from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray
from fusion_core.model.geometry import invert_transform
from scanloom.scene.camera_views import CameraView

# Set by hand: a dense cloud's points are about so far apart at a few metres.
_POINT_M = 0.011
# The viewer stands behind the camera, and above.
_BEHIND_M, _ABOVE_M = 2.4, 0.6
# The lower part of the screen is covered: what is looked at lies below the middle of the cloud.
_BELOW_M = 0.7
_UP = np.array([0.0, 0.0, 1.0])


class ColoredCloudNode:
    """One cloud at a time, hidden at first."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._node: viser.PointCloudHandle | None = None

    def draw(self, points_m: Float32Array, rgb: ByteArray) -> None:
        """Draw a cloud, (N, 3) points with their colours, instead of the one before."""
        self._node = self._scene.add_point_cloud(
            "/colored_cloud",
            points_m,
            rgb,
            point_size=_POINT_M,
            point_shape="square",
            point_shading="flat",
            precision="float32",
        )

    def show(self, *, is_visible: bool) -> None:
        """Show or hide it."""
        if self._node is not None and self._node.visible != is_visible:
            self._node.visible = is_visible


def view_behind(T_camera_lidar: FloatArray, points_m: Float32Array) -> CameraView:
    """The viewpoint from behind and above a camera at this pose (4, 4) at what it sees."""
    T_lidar_camera = invert_transform(T_camera_lidar)
    ahead = T_lidar_camera[:3, 2]
    middle_m = T_lidar_camera[:3, 3] + 2.0 * ahead
    if len(points_m):
        middle_m = np.median(points_m, axis=0).astype(np.float64)
    position_m = T_lidar_camera[:3, 3] - _BEHIND_M * ahead + _ABOVE_M * _UP
    return CameraView(position_m=position_m, look_at_m=middle_m - _BELOW_M * _UP, up=_UP.copy())
