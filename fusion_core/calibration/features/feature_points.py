"""The 3D point of a feature in an intensity image (Song 2022 §3.3.1)."""

import numpy as np

from fusion_core.calibration.features.intensity_image import IntensityImage
from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.model.geometry import invert_transform, transform_points

# Fewer points around a feature do not make a plane.
_WINDOW_POINTS_MIN = 6


def nearest_points(image: IntensityImage, pixels: FloatArray) -> FloatArray:
    """(N, 3) the points of the pixels nearest to (N, 2) features, NaN where those have none."""
    columns = np.clip(np.floor(pixels[:, 0] + 0.5), 0, image.view.width - 1).astype(np.int64)
    rows = np.clip(np.floor(pixels[:, 1] + 0.5), 0, image.view.height - 1).astype(np.int64)
    return image.points_m[rows, columns].astype(np.float64)


def has_middle_fraction(pixels: FloatArray, low: float = 0.3, high: float = 0.7) -> BoolArray:
    """(N,) features of which a coordinate lies far from every pixel's centre: the paper drops
    those whose fraction lies in 0.3 to 0.7, since 3D points belong to whole pixels."""
    fraction = pixels - np.floor(pixels)
    middle: BoolArray = np.any((fraction >= low) & (fraction <= high), axis=1)
    return middle


def interpolated_points(
    image: IntensityImage, pixels: FloatArray, *, radius_px: int, edge_fraction: float
) -> tuple[FloatArray, BoolArray]:
    """(N, 3) points on the ray of each of (N, 2) features, and (N,) which lie at a depth edge.

    The points of the window around span a plane, over which 1/z is linear in the image; where they
    depart from it by more than ``edge_fraction`` of the depth, as across an edge, there is no
    point. NaN there, and where too few pixels around have one.
    """
    if not len(pixels):
        return np.empty((0, 3)), np.empty(0, dtype=np.bool_)
    view = image.view
    offsets = np.arange(-radius_px, radius_px + 1)
    columns = np.floor(pixels[:, 0] + 0.5).astype(np.int64)[:, None, None] + offsets[None, None, :]
    rows = np.floor(pixels[:, 1] + 0.5).astype(np.int64)[:, None, None] + offsets[None, :, None]
    columns, rows = (
        np.broadcast_to(a, (len(pixels), *[offsets.size] * 2)) for a in (columns, rows)
    )
    inside = (columns >= 0) & (columns < view.width) & (rows >= 0) & (rows < view.height)
    found = image.points_m[
        np.clip(rows, 0, view.height - 1), np.clip(columns, 0, view.width - 1)
    ].astype(np.float64)
    seen = transform_points(view.T_view_lidar, found.reshape(-1, 3)).reshape(*columns.shape, 3)
    known = inside & np.isfinite(seen[..., 2])
    z = np.where(known, seen[..., 2], 1.0)
    # Where each point is itself, not its pixel's centre.
    at_u = np.where(known, view.focal_px * seen[..., 0] / z + view.cx, 0.0)
    at_v = np.where(known, view.focal_px * seen[..., 1] / z + view.cy, 0.0)
    design = np.stack(
        [
            np.ones_like(z),
            at_u - pixels[:, 0, None, None],
            at_v - pixels[:, 1, None, None],
        ],
        axis=-1,
    ).reshape(len(pixels), -1, 3)
    weight = known.reshape(len(pixels), -1).astype(np.float64)
    inverse = (1.0 / z).reshape(len(pixels), -1)
    weighted = design * weight[..., None]
    # Ridge: samples along one line leave the plane's other slope at zero.
    normal = (
        np.swapaxes(weighted, 1, 2) @ design + 1e-6 * np.diag([0.0, 1.0, 1.0]) + 1e-12 * np.eye(3)
    )
    right = np.swapaxes(weighted, 1, 2) @ inverse[..., None]
    plane = np.linalg.solve(normal, right)
    off = np.abs(inverse - (design @ plane)[..., 0]) * weight
    at_centre = plane[:, 0, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        # |Δz| / z, about |Δ(1/z)| z.
        departure = off.max(axis=1) / at_centre
    enough = weight.sum(axis=1) >= _WINDOW_POINTS_MIN
    is_edge = enough & ~(departure <= edge_fraction)
    depth_m = np.where(
        enough & ~is_edge & (at_centre > 0.0), 1.0 / np.where(enough, at_centre, 1.0), np.nan
    )
    in_view = view.rays(pixels) * depth_m[:, None]
    return transform_points(invert_transform(view.T_view_lidar), in_view), is_edge
