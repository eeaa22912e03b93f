"""The presets of the viewer's camera."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from fusion_core.model.conventions import FloatArray
from fusion_core.model.geometry import transform_points as apply_transform
from scanloom.scene.image_planes import ImagePlane, Layout
from scanloom.scene.layers import Layer

# Narrow: from far above, what lies above or below the plane hardly moves sideways.
_ABOVE_FOV_RAD = float(np.deg2rad(20.0))
_FOV_RAD = float(np.deg2rad(50.0))
# A screen of this width over height shows the whole scene from its usual place.
_USUAL_ASPECT = 1.35
_LEAST_ASPECT = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraView:
    """A viewpoint. ``up``: (3,) the direction that is up on the screen; ``fov_rad`` is vertical.

    ``hides``: layers that are unreadable from this viewpoint.
    """

    position_m: FloatArray
    look_at_m: FloatArray
    up: FloatArray
    fov_rad: float = _FOV_RAD
    hides: frozenset[Layer] = frozenset()


class ViewerCamera(Protocol):
    """A browser's camera (viser's CameraHandle)."""

    position: npt.NDArray[np.float64]
    look_at: npt.NDArray[np.float64]
    up_direction: npt.NDArray[np.float64]
    fov: float


def perspective(layout: Layout, aspect: float = _USUAL_ASPECT) -> CameraView:
    """From behind and above the LiDAR, looking where the rig looks.

    ``aspect``: width over height of the screen; before a narrow one, from farther away, so that
    the image planes at both sides are in sight.
    """
    position_m = layout.ahead(-0.95 * layout.view_range_m, 0.0, 0.95 * layout.view_range_m)
    look_at_m = layout.ahead(0.6 * layout.view_range_m, 0.0, 0.05 * layout.view_range_m)
    away = max(1.0, _USUAL_ASPECT / max(aspect, _LEAST_ASPECT))
    return CameraView(
        position_m=look_at_m + away * (position_m - look_at_m),
        look_at_m=look_at_m,
        up=np.array([0.0, 0.0, 1.0]),
    )


def curve(layout: Layout) -> CameraView:
    """Straight down, to scale: x to the right and z ahead, as in Xu 2024's figures."""
    # The rows of a wall coincide, and image planes are edge-on.
    return _above(
        layout.ahead(0.5 * layout.view_range_m, 0.0, 0.0),
        1.3 * layout.view_range_m,
        up=layout.ahead(1.0, 0.0, 0.0),
        hides=frozenset({"rows", "images", "map"}),
    )


def map_from_above(
    T_lidar_map: FloatArray, origin_m: tuple[float, float], size_m: FloatArray
) -> CameraView:
    """Straight down on a whole map. ``origin_m``: its corner of least x and y in the map frame,
    ``size_m``: (2,) its extent; the map's y is up on the screen."""
    middle_m = np.array([origin_m[0] + 0.5 * size_m[0], origin_m[1] + 0.5 * size_m[1], 0.0])
    return _above(
        apply_transform(T_lidar_map, middle_m),
        1.1 * float(np.max(size_m)),
        up=T_lidar_map[:3, 1],
        hides=frozenset({"rows", "images"}),
    )


def face_plane(shown: ImagePlane) -> CameraView:
    """Straight onto an image plane."""
    plane = shown.plane
    _, down, away = plane.R_lidar_plane.T
    middle_m = np.array(plane.position_m)
    extent_m = 1.1 * max(plane.height_m, plane.width_m)
    return CameraView(
        position_m=middle_m - _distance_m(extent_m, _FOV_RAD) * away, look_at_m=middle_m, up=-down
    )


def apply(camera: ViewerCamera, view: CameraView) -> None:
    """Move a browser's camera to a viewpoint."""
    camera.fov = view.fov_rad
    # Setting the position moves the look-at point, too, so that is set afterwards.
    camera.position = view.position_m
    camera.look_at = view.look_at_m
    camera.up_direction = view.up


def _above(
    middle_m: FloatArray, height_m: float, *, up: FloatArray, hides: frozenset[Layer]
) -> CameraView:
    """Straight down; the screen's height shows ``height_m``."""
    away_m = np.array([0.0, 0.0, _distance_m(height_m, _ABOVE_FOV_RAD)])
    return CameraView(
        position_m=middle_m + away_m,
        look_at_m=middle_m,
        up=up,
        fov_rad=_ABOVE_FOV_RAD,
        hides=hides,
    )


def _distance_m(height_m: float, fov_rad: float) -> float:
    """Distance at which ``height_m`` fills the screen's height."""
    return 0.5 * height_m / float(np.tan(0.5 * fov_rad))
