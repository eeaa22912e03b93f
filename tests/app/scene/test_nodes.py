"""A browser's scene is updated in place: what is sent, what is seen, and what a click means."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import viser

from fusion_core.model.conventions import NS_PER_MS
from fusion_core.model.geometry import invert_transform, transform_from_planar
from scanloom.plots.palette import class_colors, color_of
from scanloom.scene.frame_geometry import FrameGeometry
from scanloom.scene.geometry import Frustum
from scanloom.scene.geometry_nodes import colors_of_segments
from scanloom.scene.image_planes import Layout, layout_of
from scanloom.scene.layers import LAYERS
from scanloom.scene.nodes import MapPlane, SceneNodes

LAYOUT = Layout(yaw_rad=0.0, view_range_m=4.0)
DOWN = np.array([0.0, 0.0, -1.0])


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


class Sent(list):
    """The messages that a scene queued."""

    def kinds(self) -> set[str]:
        return {type(message).__name__ for message in self}

    def updated(self) -> set[tuple[str, str]]:
        """(node, property) of each value that was given."""
        return {
            (message.name, name) for message in self for name in getattr(message, "updates", {})
        }


@pytest.fixture
def scene(server: viser.ViserServer) -> Iterator[viser.SceneApi]:
    yield server.scene
    server.scene.reset()


@pytest.fixture
def sent(scene: viser.SceneApi, monkeypatch: pytest.MonkeyPatch) -> Sent:
    kept = Sent()
    queue = scene._queue_scene_message

    def keep(message):
        kept.append(message)
        queue(message)

    monkeypatch.setattr(scene, "_queue_scene_message", keep)
    return kept


def segments(count: int, shift: float = 0.0) -> np.ndarray:
    points = np.zeros((count, 2, 3), dtype=np.float32)
    points[:, 0, 0] = np.arange(count) + shift
    points[:, 1, 0] = np.arange(count) + shift + 1.0
    return points


def frame(
    *, camera: int = 0, stamp_ns: int = 0, lines: int = 5, shift: float = 0.0, **other
) -> FrameGeometry:
    beams = np.zeros((4, 3), dtype=np.float32)
    beams[:, 0], beams[:, 1] = 2.0 + shift, [-1.0, 0.0, 1.0, np.nan]
    beams[3] = np.nan
    values = {
        "camera": camera,
        "stamp_ns": stamp_ns,
        "frustum": Frustum(
            fov_rad=0.8,
            aspect=1.3 + shift,
            wxyz=np.array([1.0, 0.0, 0.0, 0.0]),
            position_m=np.array([shift, 0.0, 0.0]),
        ),
        "rows_m": segments(lines, shift),
        "rows_depth_m": np.full(lines, 2.0 + shift, dtype=np.float32),
        "matched_m": segments(2, shift),
        "curve_m": segments(2, shift),
        "beams_m": beams,
        "pairs_m": segments(3, shift),
        "pairs_class": np.array([0, 2, 3]),
        "moved_m": segments(1, shift),
        "moved_class": np.array([2]),
        "filled_m": segments(1, shift)[:, 0],
        "filled_class": np.array([1]),
        "lowest_m": -0.4,
    }
    return FrameGeometry(**(values | other))


def node(scene: viser.SceneApi, name: str):
    return scene.get_handle_by_name(name)


def test_a_new_frame_updates_the_nodes_and_adds_none(scene, sent):
    nodes = SceneNodes(scene)
    nodes.show(frame())
    nodes.show_color(0, np.zeros((6, 8, 3), dtype=np.uint8))
    before = {name: node(scene, name) for name in ("/cameras/0/rows", "/frame/curve")}
    sent.clear()
    nodes.show(frame(shift=0.5, lines=9))
    nodes.show_color(0, np.ones((6, 8, 3), dtype=np.uint8))
    assert sent.kinds() <= {
        "SceneNodeUpdateMessage",
        "SetPositionMessage",
        "SetOrientationMessage",
        "SetSceneNodeVisibilityMessage",
    }
    assert ("/cameras/0/rows", "points") in sent.updated()
    assert ("/cameras/0/rows", "colors") in sent.updated()
    assert all(node(scene, name) is handle for name, handle in before.items())
    np.testing.assert_array_equal(node(scene, "/cameras/0/rows").points, segments(9, 0.5))
    assert node(scene, "/cameras/0/rows").colors.shape == (9, 2, 3)
    assert node(scene, "/cameras/0/frustum").aspect == pytest.approx(1.8)


def test_the_same_frame_sends_nothing(scene, sent):
    nodes = SceneNodes(scene)
    nodes.show(frame())
    sent.clear()
    nodes.show(frame())
    assert not sent.updated()


def test_points_keep_their_millimetres(scene):
    nodes = SceneNodes(scene)
    nodes.show(frame(beams_m=np.array([[9.123, 0.0, 0.0]], dtype=np.float32)))
    points = node(scene, "/frame/beams").points
    assert points.dtype == np.float32
    assert points[0, 0] == pytest.approx(9.123, abs=1e-6)


def test_what_a_frame_has_none_of_is_hidden_until_it_comes_back(scene):
    nodes = SceneNodes(scene)
    nothing = np.empty((0, 2, 3), dtype=np.float32)
    no_codes = np.empty(0, dtype=np.int64)
    nodes.show(frame())
    nodes.show(frame(pairs_m=nothing, pairs_class=no_codes, moved_m=nothing, moved_class=no_codes))
    assert not node(scene, "/frame/pairs").visible
    assert not node(scene, "/frame/moved").visible
    assert node(scene, "/frame/filled").visible
    nodes.show(frame())
    assert node(scene, "/frame/pairs").visible


def test_layers_hide_and_show(scene):
    nodes = SceneNodes(scene)
    nodes.show_image_plane(LAYOUT.depth_plane(np.zeros((3, 4, 3), dtype=np.uint8)))
    nodes.show_layers(frozenset({"curve"}))
    nodes.show(frame())
    shown = {
        name
        for name in ("/frame/curve", "/frame/beams", "/frame/pairs", "/cameras/0/rows", "/floor")
        if node(scene, name).visible
    }
    assert shown == {"/frame/curve", "/frame/beams"}
    assert not node(scene, "/images/depth").visible
    nodes.show_layers(frozenset(LAYERS))
    assert all(node(scene, name).visible for name in ("/cameras/0/rows", "/floor", "/images/depth"))


def test_pairs_have_their_class_colours(scene):
    nodes = SceneNodes(scene)
    nodes.show(frame())
    colors = node(scene, "/frame/pairs").colors
    codes = class_colors()[[0, 2, 3]]
    np.testing.assert_array_equal(colors, colors_of_segments(codes))
    np.testing.assert_array_equal(node(scene, "/frame/filled").colors, class_colors()[[1]])
    np.testing.assert_array_equal(node(scene, "/frame/curve").colors, color_of("lidar"))


def test_a_lines_colours_are_intensities():
    grey = np.array([[0, 188, 255]], dtype=np.uint8)
    # 188 of 255 in sRGB is half the light.
    assert colors_of_segments(grey).tolist() == [[[0, 128, 255]] * 2]


def test_cameras_of_one_instant_are_seen_together(scene):
    nodes = SceneNodes(scene)
    nodes.show(frame(camera=0, stamp_ns=0))
    nodes.show(frame(camera=1, stamp_ns=20 * NS_PER_MS))
    assert node(scene, "/cameras/0/rows").visible
    nodes.show(frame(camera=1, stamp_ns=2000 * NS_PER_MS))
    assert not node(scene, "/cameras/0/rows").visible
    assert not node(scene, "/cameras/0/frustum").visible
    assert node(scene, "/cameras/1/rows").visible


def test_the_floor_lies_under_the_lowest_that_was_seen(scene):
    nodes = SceneNodes(scene)
    nodes.show(frame(lowest_m=float("nan")))
    assert not node(scene, "/floor").visible
    for lowest_m, floor_m in ((-0.3, -0.3), (-0.5, -0.5), (0.2, -0.5), (float("nan"), -0.5)):
        nodes.show(frame(lowest_m=lowest_m))
        assert node(scene, "/floor").visible
        assert node(scene, "/floor").position[2] == floor_m


def test_the_map_lies_on_the_floor_around_the_lidar(scene):
    nodes = SceneNodes(scene)
    nodes.show(frame())
    picture = np.zeros((20, 40, 4), dtype=np.uint8)
    nodes.show_map(MapPlane(picture=picture, resolution_m=0.1, origin_m=(-1.0, -2.0)))
    nodes.show_path(np.array([[0.0, 0.0], [0.5, 0.0]]))
    assert not node(scene, "/in_map").visible
    T_map_lidar = transform_from_planar(np.array([1.0, 2.0, 0.5]))
    nodes.place_map(T_map_lidar)
    placed, shown = node(scene, "/in_map"), node(scene, "/in_map/map")
    assert placed.visible
    T_lidar_map = invert_transform(T_map_lidar)
    np.testing.assert_allclose(placed.position, [*T_lidar_map[:2, 3], -0.4])
    np.testing.assert_allclose(placed.wxyz, [np.cos(0.25), 0.0, 0.0, -np.sin(0.25)], atol=1e-9)
    nodes.show(frame(lowest_m=-0.6))
    np.testing.assert_allclose(placed.position, [*T_lidar_map[:2, 3], -0.6])
    assert (shown.render_width, shown.render_height) == (4.0, 2.0)
    np.testing.assert_allclose(shown.position[:2], [1.0, -1.0])
    larger = np.zeros((30, 40, 4), dtype=np.uint8)
    nodes.show_map(MapPlane(picture=larger, resolution_m=0.1, origin_m=(-1.0, -2.0)))
    assert node(scene, "/in_map/map") is shown
    assert shown.render_height == 3.0
    nodes.show_layers(frozenset({"curve"}))
    assert not placed.visible
    nodes.show_layers(frozenset(LAYERS))
    assert placed.visible
    nodes.place_map(None)
    assert not placed.visible
    nodes.show_map(None)
    assert not shown.visible


def test_an_image_plane_takes_a_new_picture_in_place(scene, sent):
    nodes = SceneNodes(scene)
    nodes.show_image_plane(LAYOUT.depth_plane(np.zeros((30, 40, 3), dtype=np.uint8)))
    shown = node(scene, "/images/depth")
    sent.clear()
    nodes.show_image_plane(LAYOUT.depth_plane(np.full((40, 40, 3), 9, dtype=np.uint8)))
    assert node(scene, "/images/depth") is shown
    assert "ImageMessage" not in sent.kinds()
    assert ("/images/depth", "_data") in sent.updated()
    assert shown.render_width == pytest.approx(shown.render_height)


def test_a_click_means_the_image_plane_before_the_beam_behind_it(scene):
    nodes = SceneNodes(scene)
    image_plane = LAYOUT.heatmap_plane(np.zeros((30, 40, 3), dtype=np.uint8))
    nodes.show_image_plane(image_plane)
    target = image_plane.plane.at_pixel(7.0, 5.0)
    eye = target - image_plane.plane.R_lidar_plane[:, 2]
    behind = target + image_plane.plane.R_lidar_plane[:, 2]
    nodes.show(frame(beams_m=behind[np.newaxis].astype(np.float32)))
    picked = nodes.pick(eye, behind - eye)
    assert picked is not None
    assert (picked.plane, picked.beam) == ("heatmap", None)
    assert picked.pixel == pytest.approx((7.0, 5.0))
    nodes.show_layers(frozenset(LAYERS) - {"images"})
    picked = nodes.pick(eye, behind - eye)
    assert picked is not None
    assert picked.beam == 0
    nodes.show_layers(frozenset({"rows"}))
    assert nodes.pick(eye, behind - eye) is None


def test_a_marked_beam_is_pointed_at_in_each_frame(scene):
    nodes = SceneNodes(scene)
    nodes.mark_beam(1)
    assert not node(scene, "/frame/mark").visible
    nodes.show(frame())
    nodes.show(frame(shift=0.5))
    mark = node(scene, "/frame/mark")
    assert mark.visible
    np.testing.assert_allclose(mark.points[0, 1], [2.5, 0.0, 0.0])
    for beam in (3, 99, None):
        nodes.mark_beam(beam)
        assert not mark.visible


def test_a_hidden_frame_leaves_floor_and_map_until_the_next(scene):
    nodes = SceneNodes(scene)
    nodes.show(frame())
    nodes.mark_beam(1)
    nodes.show_map(
        MapPlane(picture=np.zeros((4, 4, 3), np.uint8), resolution_m=1.0, origin_m=(0, 0))
    )
    nodes.place_map(np.eye(4))
    of_frame = ("matched", "curve", "beams", "pairs", "moved", "filled", "mark")
    names = [*(f"/frame/{name}" for name in of_frame), "/cameras/0/rows", "/cameras/0/frustum"]
    assert all(node(scene, name).visible for name in names)
    nodes.hide_frame()
    assert not any(node(scene, name).visible for name in names)
    assert nodes.pick(np.array([2.0, 0.0, 5.0]), DOWN) is None
    assert node(scene, "/floor").visible
    assert node(scene, "/in_map").visible
    nodes.show(frame())
    assert all(node(scene, name).visible for name in names)


def test_a_hidden_image_plane_is_neither_seen_nor_picked_until_the_next(scene):
    nodes = SceneNodes(scene)
    image_plane = LAYOUT.depth_plane(np.zeros((30, 40, 3), dtype=np.uint8))
    nodes.show_image_plane(image_plane)
    middle = np.array(image_plane.plane.position_m)
    eye = middle - image_plane.plane.R_lidar_plane[:, 2]
    assert nodes.pick(eye, middle - eye) is not None
    nodes.hide_image_plane("depth")
    nodes.hide_image_plane("depth")
    assert nodes.pick(eye, middle - eye) is None
    assert node(scene, "/images/depth") is None
    nodes.show_image_plane(image_plane)
    assert nodes.pick(eye, middle - eye) is not None


def test_clearing_leaves_nothing_to_be_seen_or_picked(scene):
    nodes = SceneNodes(scene)
    nodes.show(frame())
    nodes.show_image_plane(LAYOUT.depth_plane(np.zeros((3, 4, 3), dtype=np.uint8)))
    nodes.place_map(np.eye(4))
    nodes.clear()
    assert node(scene, "/cameras/0/rows") is None
    assert node(scene, "/images/depth") is None
    for name in ("/frame/curve", "/frame/beams", "/frame/pairs", "/lidar", "/floor", "/in_map"):
        assert not node(scene, name).visible
    assert nodes.pick(np.array([2.0, 0.0, 3.0]), DOWN) is None
    nodes.show(frame(lowest_m=-0.2))
    assert node(scene, "/floor").position[2] == -0.2
    assert node(scene, "/frame/curve").visible


def test_a_layout_reaches_as_far_as_the_frame_sees():
    near = layout_of(frame(lines=1), 0.3)
    far = layout_of(replace(frame(lines=11)), 0.3)
    assert (near.view_range_m, near.yaw_rad) == (2.0, 0.3)
    assert far.view_range_m == pytest.approx(9.0)
    nothing = frame(rows_m=segments(0), beams_m=np.empty((0, 3), dtype=np.float32))
    assert layout_of(nothing, 0.0).view_range_m == 4.0
