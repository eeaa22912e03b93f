"""Clicks on image planes and beams, there and back."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.geometry import (
    invert_transform,
    rotation_from_yaw_pitch_roll,
    transform_from_planar,
)
from scanloom.scene.camera_views import (
    ViewerCamera,
    apply,
    curve,
    face_plane,
    map_from_above,
    perspective,
)
from scanloom.scene.color_picture import upright_color
from scanloom.scene.geometry import quaternion
from scanloom.scene.image_planes import ImagePlane, Layout
from scanloom.scene.picking import Plane, nearest_beam

LAYOUT = Layout(yaw_rad=0.4, view_range_m=4.0)
angles = st.floats(-3.1, 3.1)
metres = st.floats(-5.0, 5.0)
PICTURE = np.zeros((30, 40, 3), dtype=np.uint8)


def plane_at(yaw: float, pitch: float, roll: float, position: tuple[float, float, float]) -> Plane:
    q = quaternion(rotation_from_yaw_pitch_roll(yaw, pitch, roll))
    return Plane(
        width_m=2.0, width_px=80, height_px=60, wxyz=tuple(map(float, q)), position_m=position
    )


@given(
    angles,
    angles,
    angles,
    st.tuples(metres, metres, metres),
    st.tuples(st.floats(-0.4, 79.4), st.floats(-0.4, 59.4)),
    st.tuples(metres, metres, st.floats(0.5, 6.0)),
    st.sampled_from([-1.0, 1.0]),
)
def test_a_ray_to_a_pixel_hits_that_pixel(yaw, pitch, roll, position, pixel, beside, side):
    plane = plane_at(yaw, pitch, roll, position)
    target = plane.at_pixel(*pixel)
    eye = target + plane.R_lidar_plane @ np.array([beside[0], beside[1], side * beside[2]])
    hit = plane.pixel_at(eye, 0.3 * (target - eye))
    assert hit == pytest.approx(pixel, abs=1e-6)
    assert plane.pixel_at(eye, eye - target) is None


def test_a_ray_beside_or_along_a_plane_misses():
    plane = plane_at(0.0, 0.0, 0.0, (0.0, 0.0, 1.0))
    eye = np.array([0.0, 0.0, -1.0])
    assert plane.pixel_at(eye, np.array([0.0, 0.0, 1.0])) == pytest.approx((39.5, 29.5))
    assert plane.pixel_at(eye, np.array([1.02, 0.0, 2.0])) is None
    assert plane.pixel_at(eye, np.array([0.0, 0.76, 2.0])) is None
    assert plane.pixel_at(eye, np.array([1.0, 0.0, 0.0])) is None


def test_planes_face_the_viewer_unmirrored():
    eye = perspective(LAYOUT).position_m
    left_of_view = LAYOUT.ahead(0.0, 1.0, 0.0)
    depth, heatmap = LAYOUT.depth_plane(PICTURE), LAYOUT.heatmap_plane(PICTURE)
    for shown in (depth, heatmap):
        plane = shown.plane
        top_left, top_right = plane.at_pixel(0, 0), plane.at_pixel(39, 0)
        bottom_left = plane.at_pixel(0, 29)
        assert (top_left - top_right) @ left_of_view > 0.0
        assert top_left[2] > bottom_left[2] > 0.0
        away = plane.R_lidar_plane[:, 2]
        assert away @ (np.array(plane.position_m) - eye) > 0.0
    sides = [np.array(b.plane.position_m) @ left_of_view for b in (depth, heatmap)]
    assert sides[0] > 0.0 > sides[1]


@pytest.mark.parametrize("shape", [(30, 40), (240, 60), (60, 240)])
def test_planes_hide_nothing_that_the_camera_sees(shape):
    eye = perspective(LAYOUT).position_m
    picture = np.zeros((*shape, 3), dtype=np.uint8)
    for shown in (LAYOUT.depth_plane(picture), LAYOUT.heatmap_plane(picture)):
        for angle, height_m in product(np.linspace(-0.45, 0.45, 19), np.linspace(-1.0, 1.5, 11)):
            point = LAYOUT.ahead(4.0 * np.cos(angle), 4.0 * np.sin(angle), height_m)
            assert shown.pixel_at(eye, point - eye) is None


def test_an_image_plane_has_the_shape_of_its_picture():
    with pytest.raises(ValueError, match="does not fit"):
        ImagePlane(
            name="x", rgb=np.zeros((3, 3, 3), np.uint8), plane=LAYOUT.depth_plane(PICTURE).plane
        )


@given(st.integers(0, 40), st.tuples(metres, metres, st.floats(1.0, 8.0)), st.floats(0.1, 9.0))
def test_a_ray_to_a_beam_means_that_beam(beam, eye, length):
    beams_m = np.zeros((41, 3), dtype=np.float32)
    beams_m[:, 0], beams_m[:, 1] = 3.0, np.linspace(-2.0, 2.0, 41)
    direction = length * (beams_m[beam] - np.array(eye))
    assert nearest_beam(beams_m, np.array(eye), direction) == beam


def test_beams_without_a_point_or_far_from_the_ray_are_not_meant():
    beams_m = np.array([[np.nan] * 3, [3.0, 0.0, 0.0], [3.0, 1.0, 0.0]], dtype=np.float32)
    eye = np.array([0.0, 0.0, 0.0])
    assert nearest_beam(beams_m, eye, np.array([1.0, 0.01, 0.0])) == 1
    assert nearest_beam(beams_m, eye, np.array([1.0, 0.1, 0.0])) is None
    assert nearest_beam(beams_m, eye, np.array([-1.0, 0.0, 0.0])) is None
    assert nearest_beam(beams_m[:1], eye, np.array([1.0, 0.0, 0.0])) is None
    assert nearest_beam(beams_m[:0], eye, np.array([1.0, 0.0, 0.0])) is None


class Recorder(ViewerCamera):
    """Like viser's: moving it takes its point along."""

    def __init__(self) -> None:
        self.fov, self.up_direction = 1.0, np.array([0.0, 0.0, 1.0])
        self._position, self.look_at = np.zeros(3), np.ones(3)

    @property
    def position(self):
        return self._position

    @position.setter
    def position(self, value):
        self.look_at = self.look_at + value - self._position
        self._position = value


def on_screen(view, point: np.ndarray) -> tuple[float, float]:
    """Where a point is seen: to the right and upwards, 1 at the upper edge."""
    ahead = view.look_at_m - view.position_m
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross(ahead, view.up)
    right = right / np.linalg.norm(right)
    up = np.cross(right, ahead)
    offset = point - view.position_m
    scale = (offset @ ahead) * np.tan(0.5 * view.fov_rad)
    return float(offset @ right / scale), float(offset @ up / scale)


def test_curve_view_has_right_to_the_right_and_ahead_up():
    view = curve(LAYOUT)
    origin = on_screen(view, np.zeros(3))
    ahead, left = LAYOUT.ahead(1.0, 0.0, 0.0), LAYOUT.ahead(0.0, 1.0, 0.0)
    x, y = np.subtract(on_screen(view, ahead), origin)
    assert x == pytest.approx(0.0, abs=1e-9)
    assert y > 0.0
    x_left, y_left = np.subtract(on_screen(view, left), origin)
    assert (x_left, y_left) == pytest.approx((-y, 0.0))
    assert abs(on_screen(view, LAYOUT.ahead(4.0, 0.0, 0.0))[1]) < 1.0


def test_map_view_shows_the_whole_map_upright():
    T_lidar_map = invert_transform(transform_from_planar(np.array([1.0, 2.0, 0.7])))
    view = map_from_above(T_lidar_map, (-3.0, -1.0), np.array([6.0, 4.0]))
    corners = [(-3.0, -1.0), (3.0, -1.0), (3.0, 3.0)]
    seen = [on_screen(view, (T_lidar_map @ [x, y, 0.0, 1.0])[:3]) for x, y in corners]
    assert np.abs(seen).max() < 1.0
    assert seen[1][0] - seen[0][0] > 0.0
    assert seen[1][1] == pytest.approx(seen[0][1])
    assert seen[2][1] > seen[1][1]


@pytest.mark.parametrize("aspect", [0.6, 0.75, 1.0, 1.13, 1.4, 1.9])
@pytest.mark.parametrize("shape", [(290, 560), (420, 500)])
def test_both_planes_are_in_sight_on_any_screen(aspect, shape):
    view = perspective(LAYOUT, aspect)
    picture = np.zeros((*shape, 3), dtype=np.uint8)
    for shown in (LAYOUT.depth_plane(picture), LAYOUT.heatmap_plane(picture)):
        for corner in product((0, shape[1] - 1), (0, shape[0] - 1)):
            x, y = on_screen(view, shown.plane.at_pixel(*corner))
            assert abs(x) < aspect
            assert abs(y) < 1.0


def test_a_wide_screen_is_seen_from_the_usual_place():
    np.testing.assert_allclose(
        perspective(LAYOUT, 2.5).position_m, perspective(LAYOUT, 1.4).position_m
    )


def test_plane_view_shows_an_image_plane_upright():
    shown = LAYOUT.heatmap_plane(PICTURE)
    view = face_plane(shown)
    x, y = on_screen(view, shown.plane.at_pixel(0, 0))
    assert -1.0 < x < -0.5
    assert 0.5 < y < 1.0


def test_the_camera_looks_where_the_view_says():
    camera = Recorder()
    view = perspective(LAYOUT)
    apply(camera, view)
    np.testing.assert_allclose(camera.look_at, view.look_at_m)
    np.testing.assert_allclose(camera.position, view.position_m)
    assert camera.fov == view.fov_rad


def test_colour_is_turned_cut_and_made_small_as_the_depth():
    stored = np.zeros((200, 400, 3), dtype=np.uint8)
    stored[:100, 200:] = 255
    lens = SimpleNamespace(width=100)
    turned = SimpleNamespace(
        R_stored_view=np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        stored_shape=(100, 200),
        intrinsics=lens,
    )
    picture = upright_color(stored, SimpleNamespace(views=(turned,)), 0)
    assert picture.shape == (400, 200, 3)
    np.testing.assert_array_equal(picture, np.rot90(stored, 1))
    half = SimpleNamespace(R_stored_view=np.eye(3), stored_shape=(100, 200), intrinsics=lens)
    picture = upright_color(stored, SimpleNamespace(views=(half,)), 0, most_px=50)
    assert picture.shape == (50, 50, 3)
    assert picture[5, 45].tolist() == [255, 255, 255]
