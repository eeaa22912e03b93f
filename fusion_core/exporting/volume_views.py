"""Coloured clouds and surfaces seen through a virtual camera, drawn without a screen."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray
from fusion_core.model.dense_map import ColoredCloud, ColoredMesh
from fusion_core.model.geometry import invert_transform, make_transform, transform_points

Color = tuple[int, int, int]

NOTHING: Color = (255, 255, 255)
"""Where the camera sees neither."""

# A point is a square of its voxel's size, so that a near surface has no gaps; no larger than this.
_POINT_RADIUS_MAX_PX = 5
_NEAREST_M = 0.05
# How dark a surface becomes that is seen at a grazing angle.
_AMBIENT = 0.6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VirtualCamera:
    """A pinhole camera in the middle of its image. ``T_map_eye``: (4, 4) of its optical frame."""

    T_map_eye: FloatArray
    focal_px: float
    width: int
    height: int


def bird_view(
    points_in_map_m: FloatArray, heading: FloatArray, elevation_rad: float, width: int, height: int
) -> VirtualCamera:
    """A camera that sees all of (N, 3) points from obliquely above.

    ``heading``: (3,) the direction in which it looks, whose z is ignored.
    """
    flat = np.array([heading[0], heading[1], 0.0])
    length = float(np.linalg.norm(flat))
    flat = flat / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    ahead = np.cos(elevation_rad) * flat - np.sin(elevation_rad) * np.array([0.0, 0.0, 1.0])
    right = np.cross(flat, [0.0, 0.0, 1.0])
    R_map_eye = np.column_stack([right, np.cross(ahead, right), ahead])
    centre_m = 0.5 * (points_in_map_m.min(axis=0) + points_in_map_m.max(axis=0))
    in_eye_m = (points_in_map_m - centre_m) @ R_map_eye
    # A field of view of 40 degrees keeps parallels nearly parallel.
    focal_px = 0.5 * width / np.tan(np.deg2rad(20.0))
    tangents = 0.5 * np.array([width, height]) / focal_px
    # The eye's distance from the centre at which the last point enters the image.
    away_m = float((np.abs(in_eye_m[:, :2]) / tangents - in_eye_m[:, 2:]).max())
    return VirtualCamera(
        T_map_eye=make_transform(R_map_eye, centre_m - 1.03 * away_m * ahead),
        focal_px=float(focal_px),
        width=width,
        height=height,
    )


def draw_cloud(cloud: ColoredCloud, voxel_m: float, camera: VirtualCamera) -> ByteArray:
    """(height, width, 3) the points nearest to the camera, each as large as its voxel."""
    in_eye_m = transform_points(invert_transform(camera.T_map_eye), cloud.points_in_map_m)
    ahead = in_eye_m[:, 2] > _NEAREST_M
    in_eye_m, rgb = in_eye_m[ahead], cloud.rgb[ahead]
    z_m = in_eye_m[:, 2]
    pixels = camera.focal_px * in_eye_m[:, :2] / z_m[:, np.newaxis]
    pixels += 0.5 * np.array([camera.width, camera.height])
    radii_px = np.ceil(0.5 * camera.focal_px * voxel_m / z_m).clip(0, _POINT_RADIUS_MAX_PX)
    return _draw_squares(pixels, z_m, radii_px, rgb, (camera.height, camera.width))


def draw_plan(
    cloud: ColoredCloud, extent: tuple[float, float, float, float], pixel_m: float
) -> ByteArray:
    """(rows, columns, 3) the highest points seen from straight above; row 0 is the largest y.

    ``extent``: left, right, bottom, top in the map.
    """
    left, right, bottom, top = extent
    shape = (
        max(int(np.ceil((top - bottom) / pixel_m)), 1),
        max(int(np.ceil((right - left) / pixel_m)), 1),
    )
    x_m, y_m, z_m = cloud.points_in_map_m.T
    pixels = np.column_stack([(x_m - left) / pixel_m, (top - y_m) / pixel_m])
    return _draw_squares(pixels, -z_m, np.zeros(len(z_m)), cloud.rgb, shape)


def _draw_squares(
    pixels: FloatArray,
    distances: FloatArray,
    radii_px: FloatArray,
    rgb: ByteArray,
    shape: tuple[int, int],
) -> ByteArray:
    """Squares at (N, 2) pixels, the nearest on top."""
    height, width = shape
    image = np.full((height * width, 3), NOTHING, dtype=np.uint8)
    nearest = np.full(height * width, np.inf)
    # Far to near: of two points on a pixel the later assignment remains.
    order = np.argsort(-distances, kind="stable")
    places = np.floor(pixels[order]).astype(np.int64)
    distances, radii_px, rgb = distances[order], radii_px[order], rgb[order]
    winner = np.empty(height * width, dtype=np.int64)
    for radius in range(int(radii_px.max(initial=0.0)) + 1):
        large = np.flatnonzero(radii_px >= radius)
        for across, down in _ring(radius):
            u, v = places[large, 0] + across, places[large, 1] + down
            inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
            winner[:] = -1
            winner[v[inside] * width + u[inside]] = large[inside]
            at = np.flatnonzero(winner >= 0)
            point = winner[at]
            nearer = distances[point] < nearest[at]
            at, point = at[nearer], point[nearer]
            nearest[at], image[at] = distances[point], rgb[point]
    return image.reshape(height, width, 3)


def _ring(radius: int) -> list[tuple[int, int]]:
    """The pixels at a radius in the larger of both coordinates."""
    span = range(-radius, radius + 1)
    return [(u, v) for v in span for u in span if max(abs(u), abs(v)) == radius]


def draw_mesh(mesh: ColoredMesh, camera: VirtualCamera) -> ByteArray:
    """(height, width, 3) the surface, lit from the camera; its back is not drawn, so that rooms can
    be looked into from outside."""
    # Imported here: it takes most of a second and 200 MiB.
    import open3d as o3d

    eye_m = camera.T_map_eye[:3, 3]
    corners_m = mesh.vertices_in_map_m.astype(np.float64)[mesh.triangles]
    normals = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    facing = np.einsum("ij,ij->i", normals, eye_m - corners_m[:, 0]) > 0.0
    image = np.full((camera.height * camera.width, 3), NOTHING, dtype=np.uint8)
    if facing.any():
        triangles, normals = mesh.triangles[facing], normals[facing]
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(
            o3d.core.Tensor.from_numpy(np.array(mesh.vertices_in_map_m)),
            o3d.core.Tensor.from_numpy(triangles.astype(np.uint32)),
        )
        v, u = np.mgrid[: camera.height, : camera.width] + 0.5
        rays = np.stack([u - 0.5 * camera.width, v - 0.5 * camera.height, 0.0 * u], axis=-1)
        rays[:, :, 2] = camera.focal_px
        rays /= np.linalg.norm(rays, axis=2, keepdims=True)
        rays = rays.reshape(-1, 3) @ camera.T_map_eye[:3, :3].T
        cast = scene.cast_rays(
            o3d.core.Tensor.from_numpy(
                np.hstack([np.broadcast_to(eye_m, rays.shape), rays]).astype(np.float32)
            )
        )
        hit = np.isfinite(cast["t_hit"].numpy())
        triangle = cast["primitive_ids"].numpy()[hit]
        second, third = cast["primitive_uvs"].numpy()[hit].T
        weights = np.column_stack([1.0 - second - third, second, third])
        color = np.einsum("ij,ijk->ik", weights, mesh.rgb[triangles[triangle]].astype(np.float64))
        normal = normals[triangle] / np.linalg.norm(normals[triangle], axis=1, keepdims=True)
        towards = np.abs(np.einsum("ij,ij->i", normal, rays[hit]))
        lit = color * (_AMBIENT + (1.0 - _AMBIENT) * towards)[:, np.newaxis]
        image[hit] = np.rint(lit.clip(0.0, 255.0)).astype(np.uint8)
    return image.reshape(camera.height, camera.width, 3)
