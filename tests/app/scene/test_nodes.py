"""A browser's scene is updated in place: what is sent, what is seen, and what a click means."""

from collections.abc import Iterator

import numpy as np
import pytest
import viser

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import NS_PER_MS
from fusion_core.model.geometry import invert_transform, transform_from_planar
from scanloom.plots.palette import class_colors, color_of
from scanloom.scene.camera_views import CameraView
from scanloom.scene.depth_surface import DepthSurface
from scanloom.scene.frame_geometry import FrameGeometry
from scanloom.scene.geometry import Frustum
from scanloom.scene.geometry_nodes import colors_of_segments
from scanloom.scene.layers import LAYERS
from scanloom.scene.map_nodes import MapPlane
from scanloom.scene.nodes import SceneNodes
from scanloom.scene.stage_colors import DARK, LIGHT

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


def surface(count: int, shift: float = 0.0) -> DepthSurface:
    points = segments(count, shift)[:, 0].copy()
    return DepthSurface(
        points_m=points,
        depth_m=points[:, 0].copy(),
        down=np.linspace(0.1, 0.9, count, dtype=np.float32),
        right=np.full(count, 0.5, dtype=np.float32),
        point_m=0.02,
    )


def rgb(count: int, value: int = 100) -> np.ndarray:
    return np.full((count, 3), value, dtype=np.uint8)


def show(nodes: SceneNodes, shown: FrameGeometry) -> None:
    nodes.show(shown, rgb(len(shown.surface.points_m)))


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
        "surface": surface(lines, shift),
        "rows_m": segments(lines, shift),
        "matched_m": segments(2, shift),
        "curve_m": segments(2, shift),
        "alone_m": segments(1, shift)[:, 0],
        "beams_m": beams,
        "pixels_m": beams + np.float32(0.1),
        "pairs_m": segments(3, shift),
        "pairs_class": np.array([0, 2, 3]),
        "marks_m": segments(4, shift)[:, 0],
        "marks_class": np.array([0, 1, 2, 3]),
        "moved_m": segments(1, shift),
        "moved_class": np.array([2]),
        "filled_m": segments(1, shift)[:, 0],
        "filled_class": np.array([1]),
        "lowest_m": -0.4,
        "body": "LiDAR",
        "body_m": (0.0, 0.0, 0.0),
    }
    return FrameGeometry(**(values | other))


def node(scene: viser.SceneApi, name: str):
    return scene.get_handle_by_name(name)


def test_a_new_frame_updates_the_nodes_and_adds_none(scene, sent):
    nodes = SceneNodes(scene)
    show(nodes, frame())
    names = ("/cameras/0/surface", "/cameras/0/rows", "/frame/curve")
    before = {name: node(scene, name) for name in names}
    sent.clear()
    nodes.show(frame(shift=0.5, lines=9), rgb(9, 50))
    assert sent.kinds() <= {
        "SceneNodeUpdateMessage",
        "SetPositionMessage",
        "SetOrientationMessage",
        "SetSceneNodeVisibilityMessage",
    }
    assert ("/cameras/0/surface", "points") in sent.updated()
    assert ("/cameras/0/surface", "colors") in sent.updated()
    assert all(node(scene, name) is handle for name, handle in before.items())
    seen = node(scene, "/cameras/0/surface")
    np.testing.assert_allclose(seen.points, surface(9, 0.5).points_m, atol=4e-3)
    assert seen.points.dtype == np.float16
    assert seen.colors.shape == (9, 3)
    assert node(scene, "/cameras/0/frustum").aspect == pytest.approx(1.8)


def test_the_same_frame_sends_nothing(scene, sent):
    nodes = SceneNodes(scene)
    show(nodes, frame())
    sent.clear()
    show(nodes, frame())
    assert not sent.updated()


def test_a_layer_that_is_off_is_not_sent(scene, sent):
    nodes = SceneNodes(scene)
    nodes.show_layers(frozenset({"curve"}))
    show(nodes, frame())
    sent.clear()
    show(nodes, frame(shift=0.5))
    names = {name for name, _ in sent.updated()}
    assert "/frame/curve" in names
    assert not names & {"/cameras/0/surface", "/cameras/0/rows", "/frame/pairs", "/frame/classes"}
    nodes.show_layers(frozenset({"surface"}))
    show(nodes, frame(shift=0.5))
    np.testing.assert_allclose(
        node(scene, "/cameras/0/surface").points, surface(5, 0.5).points_m, atol=4e-3
    )


def test_what_a_frame_has_none_of_is_hidden_until_it_comes_back(scene):
    nodes = SceneNodes(scene)
    nothing = np.empty((0, 2, 3), dtype=np.float32)
    no_codes = np.empty(0, dtype=np.int64)
    show(nodes, frame())
    show(nodes, frame(pairs_m=nothing, pairs_class=no_codes, moved_m=nothing, moved_class=no_codes))
    assert not node(scene, "/frame/pairs").visible
    assert not node(scene, "/frame/moved").visible
    assert node(scene, "/frame/filled").visible
    show(nodes, frame())
    assert node(scene, "/frame/pairs").visible


def test_layers_hide_and_show(scene):
    nodes = SceneNodes(scene)
    nodes.show_layers(frozenset({"curve"}))
    show(nodes, frame())
    names = (
        "/frame/curve",
        "/frame/curve_edge",
        "/frame/alone",
        "/frame/pairs",
        "/frame/classes",
        "/cameras/0/surface",
        "/cameras/0/rows",
        "/cameras/0/frustum",
        "/labels/curve",
        "/floor",
    )
    shown = {name for name in names if node(scene, name).visible}
    assert shown == {"/frame/curve", "/frame/curve_edge", "/frame/alone"}
    nodes.show_layers(frozenset(LAYERS))
    show(nodes, frame())
    assert all(node(scene, name).visible for name in names)


def test_classes_have_their_colours_and_shapes(scene):
    nodes = SceneNodes(scene)
    show(nodes, frame())
    codes = class_colors()[[0, 2, 3]]
    np.testing.assert_array_equal(node(scene, "/frame/pairs").colors, colors_of_segments(codes))
    np.testing.assert_array_equal(node(scene, "/frame/curve").colors, color_of("lidar"))
    np.testing.assert_array_equal(node(scene, "/frame/good").colors, color_of("good"))
    drawn = {tuple(color) for color in node(scene, "/frame/classes").colors[:, 0]}
    others = [NoiseClass.HOLE, NoiseClass.BURR, NoiseClass.CONFLICT]
    assert drawn == {tuple(color) for color in colors_of_segments(class_colors()[others])[:, 0]}


def test_lines_lie_before_the_surface_at_the_same_place_on_the_screen(scene):
    nodes = SceneNodes(scene)
    eye = np.array([-3.0, 1.0, 2.0])
    nodes.face(CameraView(position_m=eye, look_at_m=np.zeros(3), up=np.array([0.0, 0.0, 1.0])))
    show(nodes, frame())
    drawn = node(scene, "/frame/curve").points.astype(float)
    behind = node(scene, "/frame/curve_edge").points.astype(float)
    true = segments(2)
    for points in (drawn, behind):
        along = np.cross(points - eye, true - eye)
        np.testing.assert_allclose(along, 0.0, atol=1e-5)
    distance = [np.linalg.norm(points - eye, axis=-1) for points in (drawn, behind, true)]
    assert (distance[0] < distance[1]).all()
    assert (distance[1] < distance[2]).all()
    # 5 to 10 cm at the distance of a room.
    assert 0.01 < 1.0 - (distance[0] / distance[2]).min() < 0.03


def test_shapes_turn_to_a_viewer_who_walks_around(scene, sent):
    nodes = SceneNodes(scene)
    up = np.array([0.0, 0.0, 1.0])
    there = CameraView(position_m=np.array([-3.0, 0.0, 2.0]), look_at_m=np.zeros(3), up=up)
    nodes.face(there)
    show(nodes, frame())
    sent.clear()
    nodes.face(CameraView(position_m=np.array([-3.0, 0.1, 2.0]), look_at_m=np.zeros(3), up=up))
    assert not sent.updated()
    nodes.face(CameraView(position_m=np.array([0.0, -3.0, 2.0]), look_at_m=np.zeros(3), up=up))
    assert ("/frame/classes", "points") in sent.updated()
    sent.clear()
    nodes.face(CameraView(position_m=np.full(3, np.nan), look_at_m=np.zeros(3), up=up))
    assert not sent.updated()


def test_what_is_pointed_at_lights_up_and_little_is_sent(scene, sent):
    nodes = SceneNodes(scene)
    show(nodes, frame())
    assert not node(scene, "/frame/hover").visible
    sent.clear()
    nodes.mark_hover(1)
    hover = node(scene, "/frame/hover")
    assert hover.visible
    assert {name for name, _ in sent.updated()} == {"/frame/hover"}
    # The ray, and a ring each around the beam's end and the camera's point.
    assert len(hover.points) == 25
    nodes.mark_hover(None, (0.5, 0.5))
    assert len(hover.points) == 12
    for nothing in (None, 3, 99, -1):
        nodes.mark_hover(nothing)
        assert not hover.visible


def test_a_dark_ground_has_light_ink(scene):
    nodes = SceneNodes(scene)
    show(nodes, frame())
    nodes.set_dark(True)
    np.testing.assert_array_equal(node(scene, "/frame/mark").colors, DARK.ink)
    assert tuple(node(scene, "/floor").cell_color) == DARK.cell
    assert tuple(node(scene, "/cameras/0/frustum").color) == DARK.camera
    show(nodes, frame(camera=1))
    assert tuple(node(scene, "/cameras/1/frustum").color) == DARK.camera
    nodes.set_dark(False)
    np.testing.assert_array_equal(node(scene, "/frame/mark").colors, LIGHT.ink)


def test_a_lines_colours_are_intensities():
    grey = np.array([[0, 188, 255]], dtype=np.uint8)
    # 188 of 255 in sRGB is half the light.
    assert colors_of_segments(grey).tolist() == [[[0, 128, 255]] * 2]


def test_cameras_of_one_instant_are_seen_together(scene):
    nodes = SceneNodes(scene)
    show(nodes, frame(camera=0, stamp_ns=0))
    show(nodes, frame(camera=1, stamp_ns=20 * NS_PER_MS))
    assert node(scene, "/cameras/0/surface").visible
    later = frame(camera=1, stamp_ns=2000 * NS_PER_MS, shift=0.5)
    show(nodes, later)
    np.testing.assert_allclose(
        node(scene, "/cameras/1/surface").points, later.surface.points_m, atol=4e-3
    )
    assert not node(scene, "/cameras/0/surface").visible
    assert not node(scene, "/cameras/0/frustum").visible
    assert node(scene, "/cameras/1/surface").visible


def test_the_floor_lies_under_the_lowest_that_was_seen(scene):
    nodes = SceneNodes(scene)
    show(nodes, frame(lowest_m=float("nan")))
    assert not node(scene, "/floor").visible
    for lowest_m, floor_m in ((-0.3, -0.3), (-0.5, -0.5), (0.2, -0.5), (float("nan"), -0.5)):
        show(nodes, frame(lowest_m=lowest_m))
        assert node(scene, "/floor").visible
        assert node(scene, "/floor").position[2] == floor_m


def test_the_map_lies_in_the_lidars_plane_around_it(scene):
    nodes = SceneNodes(scene)
    show(nodes, frame())
    picture = np.zeros((20, 40, 4), dtype=np.uint8)
    nodes.map.show(MapPlane(picture=picture, resolution_m=0.1, origin_m=(-1.0, -2.0)))
    nodes.map.show_path(np.array([[0.0, 0.0], [0.5, 0.0]]))
    assert not node(scene, "/in_map").visible
    T_map_lidar = transform_from_planar(np.array([1.0, 2.0, 0.5]))
    nodes.map.place(T_map_lidar)
    placed, shown = node(scene, "/in_map"), node(scene, "/in_map/map")
    assert placed.visible
    T_lidar_map = invert_transform(T_map_lidar)
    # Over the floor, parallax would move its walls.
    np.testing.assert_allclose(placed.position, [*T_lidar_map[:2, 3], 0.0])
    assert -0.05 < shown.position[2] < 0.0
    np.testing.assert_allclose(placed.wxyz, [np.cos(0.25), 0.0, 0.0, -np.sin(0.25)], atol=1e-9)
    assert (shown.render_width, shown.render_height) == (4.0, 2.0)
    np.testing.assert_allclose(shown.position[:2], [1.0, -1.0])
    larger = np.zeros((30, 40, 4), dtype=np.uint8)
    nodes.map.show(MapPlane(picture=larger, resolution_m=0.1, origin_m=(-1.0, -2.0)))
    assert node(scene, "/in_map/map") is shown
    assert shown.render_height == 3.0
    nodes.show_layers(frozenset({"curve"}))
    assert not placed.visible
    nodes.show_layers(frozenset(LAYERS))
    assert placed.visible
    nodes.map.place(None)
    assert not placed.visible
    nodes.map.show(None)
    assert not shown.visible


def test_a_click_means_a_beam_of_a_curve_that_is_shown(scene):
    nodes = SceneNodes(scene)
    eye = np.array([2.0, 0.0, 5.0])
    assert nodes.pick(eye, DOWN) is None
    show(nodes, frame())
    assert nodes.pick(eye, DOWN) == 1
    nodes.show_layers(frozenset({"rows"}))
    assert nodes.pick(eye, DOWN) is None


def test_a_marked_beam_is_pointed_at_in_each_frame(scene):
    nodes = SceneNodes(scene)
    nodes.mark_beam(1)
    assert not node(scene, "/frame/mark").visible
    show(nodes, frame())
    show(nodes, frame(shift=0.5))
    mark = node(scene, "/frame/mark")
    assert mark.visible
    # Drawn a little before it.
    np.testing.assert_allclose(mark.points[0, 1], [2.5, 0.0, 0.0], atol=0.3)
    for beam in (3, 99, None):
        nodes.mark_beam(beam)
        assert not mark.visible


def test_a_scan_alone_is_drawn_without_a_camera(scene):
    nodes = SceneNodes(scene)
    show(nodes, frame(camera=None, frustum=None, surface=surface(0), lowest_m=float("nan")))
    assert node(scene, "/frame/curve").visible
    assert node(scene, "/lidar").visible
    assert node(scene, "/floor").position[2] == -0.2
    assert node(scene, "/cameras/0/surface") is None
    assert nodes.pick(np.array([2.0, 0.0, 5.0]), DOWN) == 1


def test_a_hidden_frame_leaves_floor_and_map_until_the_next(scene):
    nodes = SceneNodes(scene)
    show(nodes, frame())
    nodes.mark_beam(1)
    nodes.map.show(
        MapPlane(picture=np.zeros((4, 4, 3), np.uint8), resolution_m=1.0, origin_m=(0, 0))
    )
    nodes.map.place(np.eye(4))
    of_frame = ("matched", "curve", "alone", "rays", "pairs", "good", "classes", "filled", "mark")
    names = [*(f"/frame/{name}" for name in of_frame), "/cameras/0/surface", "/cameras/0/frustum"]
    assert all(node(scene, name).visible for name in names)
    nodes.hide_frame()
    assert not any(node(scene, name).visible for name in names)
    assert nodes.pick(np.array([2.0, 0.0, 5.0]), DOWN) is None
    assert node(scene, "/floor").visible
    assert node(scene, "/in_map").visible
    show(nodes, frame())
    assert all(node(scene, name).visible for name in names)


def test_clearing_leaves_nothing_to_be_seen_or_picked(scene):
    nodes = SceneNodes(scene)
    show(nodes, frame())
    nodes.map.place(np.eye(4))
    nodes.clear()
    assert node(scene, "/cameras/0/rows") is None
    for name in ("/frame/curve", "/frame/alone", "/frame/pairs", "/lidar", "/floor", "/in_map"):
        assert not node(scene, name).visible
    assert nodes.pick(np.array([2.0, 0.0, 3.0]), DOWN) is None
    show(nodes, frame(lowest_m=-0.2))
    assert node(scene, "/floor").position[2] == -0.2
    assert node(scene, "/frame/curve").visible
