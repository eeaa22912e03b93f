"""The dense cloud and the surface as pictures: through a keyframe's eyes, and from above."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fusion_core.exporting.figures import COLUMN_IN, png_figure
from fusion_core.exporting.map_axes import map_height_in, prepare_map_axes
from fusion_core.exporting.volume_views import (
    VirtualCamera,
    bird_view,
    draw_cloud,
    draw_mesh,
    draw_plan,
)
from fusion_core.model.conventions import ByteArray, FloatArray
from fusion_core.model.dense_map import ColoredCloud, ColoredMesh
from fusion_core.model.geometry import invert_transform, transform_points
from fusion_core.model.sensors import CameraIntrinsics

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# As many pixels as the figure's width has in print.
_WIDTH_PX, _HEIGHT_PX = 1050, 700
# Around the images, and the highest that a narrow plan becomes, inches.
_HEADING_IN, _TITLE_IN, _PLAN_HEIGHT_MAX_IN = 0.25, 0.2, 4.0
# The keyframe's picture, with half as much again on each side.
_WIDENED = 1.5
_ELEVATION_RAD = np.deg2rad(50.0)
# The plan shows what is lower than the cameras and this much above them: no ceiling.
_ABOVE_CAMERAS_M = 0.3
# Few points and keyframes suffice to choose a view.
_POINTS_LOOKED_AT, _KEYFRAMES_LOOKED_AT = 20_000, 100


def write_cloud_figure(
    path: Path,
    heading: str,
    cloud: ColoredCloud,
    voxel_m: float,
    T_map_camera: FloatArray,
    intrinsics: CameraIntrinsics,
) -> None:
    """The cloud from the keyframe that sees most of it, and its plan without what is above the
    cameras. ``T_map_camera``: (K, 4, 4), K >= 1, of the keyframes. Raises ExportError."""
    camera = _best_view(cloud.points_in_map_m, T_map_camera, intrinsics)
    highest_m = float(T_map_camera[:, 2, 3].max()) + _ABOVE_CAMERAS_M
    below = cloud.points_in_map_m[:, 2] <= highest_m
    if not below.any():
        below[:] = True
    plan = ColoredCloud(points_in_map_m=cloud.points_in_map_m[below], rgb=cloud.rgb[below])
    low, high = plan.points_in_map_m[:, :2].min(axis=0), plan.points_in_map_m[:, :2].max(axis=0)
    margin_m = max(0.02 * float((high - low).max()), 0.05)
    (left, bottom), (right, top) = (low - margin_m).tolist(), (high + margin_m).tolist()
    extent = (left, right, bottom, top)
    plan_in = map_height_in(extent, COLUMN_IN, _PLAN_HEIGHT_MAX_IN)
    # One pixel a voxel, unless the picture has fewer.
    pixel_m = max(voxel_m, (right - left) / _WIDTH_PX, (top - bottom) / _WIDTH_PX)
    view_in = COLUMN_IN * _HEIGHT_PX / _WIDTH_PX
    height_in = _HEADING_IN + 2 * _TITLE_IN + view_in + plan_in
    with png_figure(path, heading, height_in=height_in) as figure:
        above, below_axes = figure.subplots(2, 1, height_ratios=[view_in, plan_in])
        _show(above, draw_cloud(cloud, voxel_m, camera), "from a keyframe")
        prepare_map_axes(below_axes, extent, ticks=False)
        below_axes.imshow(draw_plan(plan, extent, pixel_m), extent=extent)
        below_axes.set_title("from above")


def write_mesh_figure(
    path: Path,
    heading: str,
    mesh: ColoredMesh,
    T_map_camera: FloatArray,
    intrinsics: CameraIntrinsics,
) -> None:
    """The surface from the keyframe that sees most of it, and from obliquely above.

    Arguments as in ``write_cloud_figure``. Raises ExportError.
    """
    vertices_m = mesh.vertices_in_map_m.astype(np.float64)
    camera = _best_view(vertices_m, T_map_camera, intrinsics)
    heading_in_map = camera.T_map_eye[:3, 2]
    oblique = bird_view(vertices_m, heading_in_map, _ELEVATION_RAD, _WIDTH_PX, _HEIGHT_PX)
    height_in = _HEADING_IN + 2 * (_TITLE_IN + COLUMN_IN * _HEIGHT_PX / _WIDTH_PX)
    with png_figure(path, heading, height_in=height_in) as figure:
        above, below = figure.subplots(2, 1)
        _show(above, draw_mesh(mesh, camera), "from a keyframe")
        _show(below, draw_mesh(mesh, oblique), "from obliquely above, without what faces away")


def _show(axes: "Axes", image: ByteArray, title: str) -> None:
    axes.imshow(image)
    axes.set_title(title)
    axes.set_xticks([])
    axes.set_yticks([])


def _best_view(
    points_m: FloatArray, T_map_camera: FloatArray, intrinsics: CameraIntrinsics
) -> VirtualCamera:
    """From where the keyframe that has most of the points before it stood, with a wider image."""
    seen_m = points_m[:: max(len(points_m) // _POINTS_LOOKED_AT, 1)]
    poses = T_map_camera[:: max(len(T_map_camera) // _KEYFRAMES_LOOKED_AT, 1)]
    counts = []
    for pose in poses:
        x_m, y_m, z_m = transform_points(invert_transform(pose), seen_m).T
        across = np.abs(intrinsics.fx * x_m) < 0.5 * intrinsics.width * z_m
        down = np.abs(intrinsics.fy * y_m) < 0.5 * intrinsics.height * z_m
        counts.append(np.count_nonzero(across & down & (z_m > 0.0)))
    return VirtualCamera(
        T_map_eye=poses[int(np.argmax(counts))],
        focal_px=intrinsics.fx * _WIDTH_PX / (_WIDENED * intrinsics.width),
        width=_WIDTH_PX,
        height=_HEIGHT_PX,
    )
