"""The surface of a sphere seen from inside, and what makes its bytes reproducible."""

import numpy as np
import pytest

from fusion_core.mapping.surface_mesh import MeshBuilder, MeshSettings, _in_canonical_order
from fusion_core.model.errors import MappingFailed, VolumeTooLarge
from fusion_core.model.sensors import CameraIntrinsics
from tests.workflows.map.sphere_frames import RADIUS_M, SphereViews, color_of

PINHOLE = CameraIntrinsics(width=80, height=60, fx=60.0, fy=62.0, cx=38.7, cy=30.9)
SETTINGS = MeshSettings(voxel_m=0.04, weight_min=1)


def sphere_mesh(count=4, settings=SETTINGS):
    builder = MeshBuilder(settings, settings.voxel_m)
    for frame, T_map_camera in SphereViews(count, PINHOLE):
        builder.add(frame.depth_m, frame.rgb, PINHOLE, T_map_camera)
    return builder.build()


def test_a_sphere():
    mesh = sphere_mesh()
    vertices_m = mesh.vertices_in_map_m.astype(np.float64)
    radii_m = np.linalg.norm(vertices_m, axis=1)
    assert np.abs(radii_m - RADIUS_M).max() < 0.02
    assert np.abs(radii_m - RADIUS_M).mean() < 0.1 * SETTINGS.voxel_m
    assert np.abs(mesh.rgb.astype(int) - color_of(vertices_m)).mean() < 4.0
    # Seen from inside: the triangles face the centre.
    corners_m = vertices_m[mesh.triangles]
    normals = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    assert (np.einsum("ij,ij->i", normals, -corners_m[:, 0]) > 0.0).mean() > 0.99
    assert len(np.unique(vertices_m, axis=0)) == len(vertices_m)


def test_the_order_of_vertices_and_triangles_is_canonical():
    mesh = sphere_mesh(2)
    random = np.random.default_rng(0)
    order = random.permutation(len(mesh.rgb))
    renamed = np.argsort(order)[mesh.triangles[random.permutation(len(mesh.triangles))]]
    turns = (random.integers(0, 3, (len(renamed), 1)) + np.arange(3)) % 3
    renamed = np.take_along_axis(renamed, turns, axis=1)
    # A vertex that is there twice, and a triangle without area between its copies.
    first = renamed[0, 0]
    shuffled_m = np.vstack([mesh.vertices_in_map_m[order], mesh.vertices_in_map_m[order[first]]])
    colors = np.vstack([mesh.rgb[order], mesh.rgb[order[first]]]) / np.float32(255.0)
    copy = len(order)
    renamed = np.vstack([renamed, [[first, copy, renamed[0, 1]]]])
    renamed[0, 0] = copy
    again = _in_canonical_order(shuffled_m, colors, renamed)
    for name in ("vertices_in_map_m", "rgb", "triangles"):
        assert np.array_equal(getattr(again, name), getattr(mesh, name)), name


def test_places_seen_too_seldom_are_left_out():
    few = sphere_mesh(settings=SETTINGS.model_copy(update={"weight_min": 2}))
    assert 0 < len(few.rgb) < len(sphere_mesh().rgb)
    # One image is enough where there are no more.
    assert len(sphere_mesh(1, SETTINGS.model_copy(update={"weight_min": 9})).rgb)


def test_nothing_and_too_much():
    builder = MeshBuilder(SETTINGS, SETTINGS.voxel_m)
    with pytest.raises(MappingFailed, match="no triangles"):
        builder.build()
    rgb = np.zeros((60, 80, 3), dtype=np.uint8)
    builder.add(np.full((60, 80), np.nan, dtype=np.float32), rgb, PINHOLE, np.eye(4))
    with pytest.raises(MappingFailed, match="no triangles"):
        builder.build()
    with pytest.raises(ValueError, match="rgb"):
        builder.add(np.ones((60, 80), dtype=np.float32), rgb[1:], PINHOLE, np.eye(4))
    small = MeshBuilder(MeshSettings(voxel_m=0.005, blocks_max=100), 0.005)
    with pytest.raises(VolumeTooLarge, match="100 blocks"):
        small.add(np.ones((60, 80), dtype=np.float32), rgb, PINHOLE, np.eye(4))
