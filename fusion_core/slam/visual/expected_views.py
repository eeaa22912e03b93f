"""Which landmarks an image at a pose should show, and where (ORB-SLAM, Mur-Artal 2015, §V.D)."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray, read_only
from fusion_core.model.geometry import transform_points
from fusion_core.slam.visual.local_map import LandmarkViews
from fusion_core.slam.visual.pinhole import project
from fusion_core.slam.visual.projection_matching import predict_octaves

# Landmarks seen from more than 60 degrees off the directions from which keyframes saw them look
# different (ORB-SLAM).
_VIEW_COSINE_MIN = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ExpectedViews:
    """``which``: (N,) of the landmarks, by their place in the ``LandmarkViews``. ``pixels``: (N, 2)
    where each is expected, ``octaves``: (N,) on which level. ``points_in_camera_m``: (N, 3)."""

    which: IntArray
    pixels: FloatArray
    octaves: IntArray
    points_in_camera_m: FloatArray

    def __post_init__(self) -> None:
        for array in (self.which, self.pixels, self.octaves, self.points_in_camera_m):
            read_only(array)


def expect_views(
    views: LandmarkViews,
    T_camera_map: FloatArray,
    camera: FloatArray,
    size: tuple[int, int],
    levels: int,
    known: IntArray,
) -> ExpectedViews:
    """The landmarks that fall into an image and are seen from a side from which they were seen.

    ``camera``: (4,) fx, fy, cx, cy. ``size``: width and height. ``levels``: of the pyramid.
    ``known``: rows of landmarks to leave out.
    """
    in_camera = transform_points(T_camera_map, views.positions_in_map_m)
    ranges_m = np.linalg.norm(in_camera, axis=1)
    pixels = project(in_camera, camera)
    width, height = size
    cosines = (in_camera @ T_camera_map[:3, :3] * views.directions).sum(axis=1) / ranges_m
    # NaN compares false.
    visible = (
        (pixels[:, 0] >= 0.0)
        & (pixels[:, 0] < width)
        & (pixels[:, 1] >= 0.0)
        & (pixels[:, 1] < height)
        & (cosines > _VIEW_COSINE_MIN)
        & ~np.isin(views.rows, known)
    )
    which = np.flatnonzero(visible)
    return ExpectedViews(
        which=which,
        pixels=pixels[which],
        octaves=predict_octaves(views.ranges_at_zero_m[which], ranges_m[which], levels),
        points_in_camera_m=in_camera[which],
    )
