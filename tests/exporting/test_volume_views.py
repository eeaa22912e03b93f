"""Clouds and surfaces through a virtual camera, pixel by pixel where that is easily said."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.exporting.volume_views import (
    NOTHING,
    VirtualCamera,
    bird_view,
    draw_cloud,
    draw_mesh,
    draw_plan,
)
from fusion_core.model.dense_map import ColoredCloud, ColoredMesh
from fusion_core.model.geometry import (
    invert_transform,
    make_transform,
    rotation_from_yaw_pitch_roll,
    transform_points,
)

CAMERA = VirtualCamera(
    T_map_eye=make_transform(
        rotation_from_yaw_pitch_roll(0.3, -0.2, 1.0), np.array([1.0, 2.0, 3.0])
    ),
    focal_px=20.0,
    width=32,
    height=24,
)


def cloud_of(points_m, rgb):
    return ColoredCloud(
        points_in_map_m=np.asarray(points_m, dtype=np.float64), rgb=np.asarray(rgb, dtype=np.uint8)
    )


@given(seed=st.integers(0, 99))
def test_squares_against_a_loop(seed):
    random = np.random.default_rng(seed)
    in_eye_m = random.uniform([-2.0, -2.0, -1.0], [2.0, 2.0, 4.0], (40, 3))
    rgb = random.integers(0, 255, (40, 3))
    points_m = transform_points(CAMERA.T_map_eye, in_eye_m)
    expected = np.full((24, 32, 3), NOTHING, dtype=np.uint8)
    nearest = np.full((24, 32), np.inf)
    for (x, y, z), color in zip(in_eye_m, rgb, strict=True):
        if z <= 0.05:
            continue
        u, v = int(np.floor(20.0 * x / z + 16.0)), int(np.floor(20.0 * y / z + 12.0))
        radius = min(int(np.ceil(0.5 * 20.0 * 0.1 / z)), 5)
        for row in range(max(v - radius, 0), min(v + radius + 1, 24)):
            for column in range(max(u - radius, 0), min(u + radius + 1, 32)):
                if z < nearest[row, column]:
                    nearest[row, column] = z
                    expected[row, column] = color
    assert np.array_equal(draw_cloud(cloud_of(points_m, rgb), 0.1, CAMERA), expected)


def test_a_plan_shows_the_highest_points_with_y_upwards():
    cloud = cloud_of(
        [[0.5, 0.5, 1.0], [0.5, 0.5, 2.0], [1.5, 2.5, 0.0]], [[1, 1, 1], [2, 2, 2], [3, 3, 3]]
    )
    plan = draw_plan(cloud, (0.0, 2.0, 0.0, 3.0), 1.0)
    assert plan[:, :, 0].tolist() == [[255, 3], [255, 255], [2, 255]]


def test_a_surface_hides_what_is_behind_and_has_no_back():
    """A red triangle before a green one that is larger, and a blue one that faces away."""
    front = [[-1.0, -1.0, 2.0], [-1.0, 1.0, 2.0], [1.0, 0.0, 2.0]]
    behind = [[-9.0, -9.0, 4.0], [-9.0, 9.0, 4.0], [20.0, 0.0, 4.0]]
    away = [[-9.0, -9.0, 1.0], [20.0, 0.0, 1.0], [-9.0, 9.0, 1.0]]
    in_eye_m = np.array([*front, *behind, *away])
    colors = np.repeat([[200, 0, 0], [0, 200, 0], [0, 0, 200]], 3, axis=0)
    mesh = ColoredMesh(
        vertices_in_map_m=transform_points(CAMERA.T_map_eye, in_eye_m).astype(np.float32),
        rgb=colors.astype(np.uint8),
        triangles=np.arange(9, dtype=np.int32).reshape(3, 3),
    )
    image = draw_mesh(mesh, CAMERA)
    assert image[12, 16].tolist() == [200, 0, 0]
    # Darker towards the rim, where it is seen at an angle.
    assert image[12, 1, 1] in range(150, 200)
    assert image[12, 1, [0, 2]].tolist() == [0, 0]
    assert not (image[:, :, 2] > 0).any()
    only_away = ColoredMesh(
        vertices_in_map_m=mesh.vertices_in_map_m, rgb=mesh.rgb, triangles=mesh.triangles[2:]
    )
    assert (draw_mesh(only_away, CAMERA) == NOTHING).all()


@pytest.mark.parametrize("heading", [(1.0, 0.0, -0.5), (-0.2, 3.0, 9.0), (0.0, 0.0, -1.0)])
def test_a_bird_sees_all(heading):
    points_m = np.random.default_rng(0).normal(size=(200, 3)) * [3.0, 1.0, 0.5]
    camera = bird_view(points_m, np.array(heading), np.deg2rad(50.0), 320, 200)
    in_eye_m = transform_points(invert_transform(camera.T_map_eye), points_m)
    pixels = camera.focal_px * in_eye_m[:, :2] / in_eye_m[:, 2:]
    assert (in_eye_m[:, 2] > 0.0).all()
    assert (np.abs(pixels) <= [160.0, 100.0]).all()
    assert (np.abs(pixels) > [130.0, 80.0]).any()
    # Upright: z of the map points up in the image.
    assert camera.T_map_eye[2, 1] < 0.0
    assert np.allclose(camera.T_map_eye[2, 0], 0.0)
    assert np.linalg.det(camera.T_map_eye[:3, :3]) == pytest.approx(1.0)
