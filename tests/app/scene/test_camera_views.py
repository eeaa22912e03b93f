"""From where each step is seen: what it is about lies within the screen, and fills it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.geometry import (
    invert_transform,
    make_transform,
    rotation_from_yaw_pitch_roll,
    transform_from_planar,
    transform_points,
)
from fusion_core.model.rig import Camera
from fusion_core.model.sensors import CameraIntrinsics
from scanloom.scene.camera_views import (
    CameraView,
    SceneWindow,
    StageExtent,
    ViewerCamera,
    apply,
    from_above,
    from_camera,
    map_from_above,
    stage_extent,
    step_view,
)
from scanloom.scene.depth_surface import depth_surface
from scanloom.scene.geometry import frustum
from scanloom.state.view import PANELS

LENS = CameraIntrinsics(width=80, height=60, fx=70.0, fy=70.0, cx=39.5, cy=29.5)
# The legend and the strip of time lie on so much of the screen's height.
ABOVE, COVERED = 0.05, 0.39


def window(aspect: float, *, above: float = ABOVE, below: float = COVERED) -> SceneWindow:
    return SceneWindow(
        width_px=900.0 * aspect, height_px=900.0, above_px=900.0 * above, below_px=900.0 * below
    )


def seen_wall(yaw_rad: float = 0.4) -> SimpleNamespace:
    """A wall, upright before a camera above the LiDAR, and a scan that meets it all around."""
    T_lidar_camera = make_transform(
        rotation_from_yaw_pitch_roll(yaw_rad, 0.0, 0.0) @ R_BODY_OPTICAL, np.array([0.1, 0.0, 0.3])
    )
    camera = Camera(topic="/d", intrinsics=LENS, T_rig_camera=np.eye(4))
    surface = depth_surface(np.full((60, 80), 3.0, np.float32), camera, T_lidar_camera)
    angles = yaw_rad + np.linspace(-np.pi, np.pi, 181)
    beams_m = 3.0 * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    pixels_m = beams_m.copy()
    pixels_m[np.abs(angles - yaw_rad) > 0.5] = np.nan
    return SimpleNamespace(
        surface=surface,
        beams_m=beams_m.astype(np.float32),
        pixels_m=pixels_m.astype(np.float32),
        frustum=frustum(camera, T_lidar_camera),
    )


EXTENT = stage_extent(seen_wall())


def on_screen(view: CameraView, points_m: np.ndarray) -> np.ndarray:
    """(N, 2) where points are seen: to the right and upwards, 1 at the upper edge."""
    ahead = view.look_at_m - view.position_m
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross(ahead, view.up)
    right = right / np.linalg.norm(right)
    up = np.cross(right, ahead)
    offset = np.atleast_2d(points_m) - view.position_m
    scale = (offset @ ahead) * np.tan(0.5 * view.fov_rad)
    assert (scale > 0.0).all()
    return np.stack([offset @ right, offset @ up], axis=1) / scale[:, np.newaxis]


@pytest.mark.parametrize("aspect", [0.46, 0.6, 0.85, 1.3, 1.9])
@pytest.mark.parametrize("step", PANELS)
def test_what_a_step_is_about_lies_in_the_part_that_nothing_covers(step, aspect):
    view = step_view(step, EXTENT, window(aspect))
    about = EXTENT.sensors_m if step in {"Recording", "Map"} else EXTENT.matched_m
    if step == "Recording":
        # Whole, not their middles alone.
        about = np.concatenate([about + 0.1 * offset for offset in (*np.eye(3), *-np.eye(3))])
    x, y = on_screen(view, about).T
    # Of pairs in disagreement some are far away.
    inside = 0.9 if step == "Register" else 1.0
    assert np.mean(np.abs(x) <= aspect) >= inside
    assert np.mean((y <= 1.0 - 2.0 * ABOVE) & (y >= -1.0 + 2.0 * COVERED)) >= inside


@pytest.mark.parametrize("step", ["Recording", "Match", "Repair"])
def test_the_surface_fills_most_of_what_nothing_covers(step):
    aspect = 0.85
    x, y = on_screen(step_view(step, EXTENT, window(aspect)), EXTENT.surface_m).T
    wide = np.ptp(np.clip(x, -aspect, aspect)) / (2.0 * aspect)
    low, top = -1.0 + 2.0 * COVERED, 1.0 - 2.0 * ABOVE
    high = np.ptp(np.clip(y, low, top)) / (top - low)
    # The sensors have to be seen whole, too.
    assert max(wide, high) > (0.8 if step == "Recording" else 0.85)
    assert wide * high > (0.3 if step == "Recording" else 0.55)


@pytest.mark.parametrize("step", PANELS)
def test_nothing_to_look_at_is_looked_at_from_somewhere(step):
    nothing = seen_wall()
    nothing.surface = depth_surface(
        np.full((60, 80), np.nan, np.float32),
        Camera(topic="/d", intrinsics=LENS, T_rig_camera=np.eye(4)),
        np.eye(4),
    )
    for beams_m in (nothing.beams_m, nothing.beams_m[:0]):
        nothing.beams_m, nothing.pixels_m = beams_m, np.full(beams_m.shape, np.nan)
        extent = stage_extent(nothing)
        for view in (step_view(step, extent, window(1.0)), from_above(extent, window(1.0))):
            assert np.isfinite(view.position_m).all()
            assert np.linalg.norm(view.position_m - view.look_at_m) > 0.4


def test_an_extent_is_that_of_what_is_seen():
    assert EXTENT.yaw_rad == pytest.approx(0.4)
    assert EXTENT.view_range_m == pytest.approx(3.4, abs=0.4)
    assert len(EXTENT.surface_m) < 1_700
    np.testing.assert_allclose(EXTENT.sensors_m, [[0.0, 0.0, 0.0], [0.1, 0.0, 0.3]])
    both = stage_extent(seen_wall(0.0), [seen_wall(1.0)])
    assert both.yaw_rad == pytest.approx(0.5)
    assert np.ptp(both.surface_m[:, 1]) > np.ptp(EXTENT.surface_m[:, 1])


def test_an_overview_does_not_hang_on_the_frame_at_which_it_is_opened():
    half = seen_wall()
    kept = half.surface.right > 0.5
    half.surface = replace(
        half.surface,
        points_m=half.surface.points_m[kept].copy(),
        depth_m=half.surface.depth_m[kept].copy(),
        down=half.surface.down[kept].copy(),
        right=half.surface.right[kept].copy(),
    )
    view = step_view("Recording", stage_extent(half), window(0.85))
    whole = step_view("Recording", EXTENT, window(0.85))
    np.testing.assert_allclose(view.position_m, whole.position_m, atol=0.02)
    assert (np.abs(on_screen(view, EXTENT.surface_m)[:, 0]) < 0.85).mean() > 0.8


def test_from_above_ahead_is_up_and_left_is_left():
    view = from_above(EXTENT, window(1.0))
    points = [np.zeros(3), EXTENT.ahead(1.0, 0.0, 0.0), EXTENT.ahead(0.0, 1.0, 0.0)]
    origin, ahead, left = on_screen(view, np.array(points))
    x, y = ahead - origin
    assert x == pytest.approx(0.0, abs=1e-9)
    assert y > 0.0
    assert tuple(left - origin) == pytest.approx((-y, 0.0))
    x, y = on_screen(view, EXTENT.near_m).T
    assert (np.abs(x) <= 1.0).all()
    assert ((y <= 1.0 - 2.0 * ABOVE) & (y >= -1.0 + 2.0 * COVERED)).all()


@pytest.mark.parametrize("aspect", [0.46, 1.5])
def test_from_above_the_sensors_of_a_scan_that_lies_ahead_are_in_sight(aspect):
    ahead_m = np.column_stack([np.linspace(3.0, 9.0, 200), np.full(200, 0.5), np.zeros(200)])
    extent = replace(EXTENT, near_m=ahead_m.astype(np.float32), yaw_rad=0.0)
    x, y = on_screen(from_above(extent, window(aspect)), extent.sensors_m).T
    assert (np.abs(x) < aspect).all()
    assert ((y < 1.0 - 2.0 * ABOVE) & (y > -1.0 + 2.0 * COVERED)).all()


@pytest.mark.parametrize("aspect", [0.46, 0.6, 0.85, 1.5])
def test_map_view_shows_the_whole_map_upright(aspect):
    T_lidar_map = invert_transform(transform_from_planar(np.array([1.0, 2.0, 0.7])))
    view = map_from_above(T_lidar_map, (-3.0, -1.0), np.array([6.0, 4.0]), window(aspect))
    corners = np.array([[-3.0, -1.0, 0.0], [3.0, -1.0, 0.0], [3.0, 3.0, 0.0]])
    seen = on_screen(view, transform_points(T_lidar_map, corners))
    assert (np.abs(seen[:, 0]) < aspect).all()
    assert (seen[:, 1] < 1.0 - 2.0 * ABOVE).all()
    assert (seen[:, 1] > -1.0 + 2.0 * COVERED).all()
    assert seen[1][0] - seen[0][0] > 0.0
    assert seen[1][1] == pytest.approx(seen[0][1])
    assert seen[2][1] > seen[1][1]


@pytest.mark.parametrize(("above", "below"), [(0.0, 0.0), (0.08, 0.43), (0.1, 0.45), (0.3, 2.0)])
def test_a_map_fills_what_its_window_leaves_free(above, below):
    shown = window(1.0, above=above, below=below)
    view = map_from_above(np.eye(4), (-2.0, -2.0), np.array([4.0, 4.0]), shown)
    corners = np.array([[-2.0, -2.0, 0.0], [2.0, 2.0, 0.0]])
    (_, low), (_, high) = on_screen(view, corners)
    assert -1.0 + 2.0 * shown.below < low < high < 1.0 - 2.0 * shown.above
    free = 2.0 * (1.0 - shown.above - shown.below)
    assert high - low == pytest.approx(free / 1.06)


def test_as_the_camera_the_image_fills_the_screen():
    seen = seen_wall()
    x, y = on_screen(from_camera(seen.frustum), seen.surface.points_m).T
    assert np.abs(y).max() == pytest.approx(1.0, abs=0.05)
    assert np.abs(x).max() == pytest.approx(seen.frustum.aspect, abs=0.05)
    # The image's upper left is the screen's.
    first = np.argmin(seen.surface.down + seen.surface.right)
    assert x[first] < 0.0 < y[first]


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


def test_the_camera_looks_where_the_view_says():
    camera = Recorder()
    view = step_view("Recording", EXTENT, window(1.0))
    apply(camera, view)
    np.testing.assert_allclose(camera.look_at, view.look_at_m)
    np.testing.assert_allclose(camera.position, view.position_m)
    assert camera.fov == view.fov_rad


def test_an_extent_is_not_to_be_written():
    assert isinstance(EXTENT, StageExtent)
    with pytest.raises(ValueError, match="read-only"):
        EXTENT.surface_m[0] = 0.0
