"""The map of visual SLAM on a browser's stage: what is sent of its cloud, and when."""

import time
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import viser

from scanloom.panels import visual_stage
from scanloom.panels.visual_stage import VisualStage
from scanloom.scene.level_of_detail import POINTS_MAX
from scanloom.scene.visual_picture import VisualPicture
from scanloom.scene.visual_shapes import Boxes
from scanloom.state.view import View
from tests.patience import ENOUGH_S, comes_true

ALL = frozenset({"cloud", "keyframes", "loops", "map"})


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


class Camera(SimpleNamespace):
    """As viser's: a new position takes the point that is looked at along."""

    def __init__(self) -> None:
        super().__init__(
            position=np.array([-3.0, 0.0, 2.0]),
            look_at=np.zeros(3),
            up_direction=np.array([0.0, 0.0, 1.0]),
            fov=0.9,
            image_width=1600,
            image_height=900,
        )


class Sent(list):
    """(points, of how many) that were sent."""

    def wait_for(self, count: int) -> None:
        assert comes_true(lambda: len(self) >= count)


@pytest.fixture
def stage(server: viser.ViserServer) -> Iterator[tuple[VisualStage, Camera, Sent]]:
    camera = Camera()
    client: Any = SimpleNamespace(client_id=1, scene=server.scene, camera=camera)

    def fail(error: Exception) -> None:
        raise AssertionError(error)

    session: Any = SimpleNamespace(
        show_failure=fail,
        batch_updates=nullcontext,
        window_px=(1600, 900),
        view=View(recording="a"),
    )
    stage, sent = VisualStage(client, session), Sent()
    stage.on_points = lambda shown, total: sent.append((shown, total))
    yield stage, camera, sent
    stage.close()


def picture(count: int, seed: int = 0) -> VisualPicture:
    """A cloud of so many points within 4 m, and one keyframe at the origin that looks along x."""
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    return VisualPicture(
        path_m=np.zeros((2, 3), np.float32),
        T_map_keyframe=T[np.newaxis],
        loops=np.empty((0, 2), np.int64),
        points_m=rng.uniform(-2.0, 2.0, (count, 3)).astype(np.float32),
        rgb=np.zeros((count, 3), np.uint8),
    )


def test_of_a_large_cloud_a_part_is_sent(stage: tuple[VisualStage, Camera, Sent]) -> None:
    shown, camera, sent = stage
    shown.draw(picture(4 * POINTS_MAX), is_new=True)
    assert not sent, "nothing is seen yet"
    shown.show(ALL, is_dark=False, is_seen=True)
    sent.wait_for(1)
    assert sent[0] == (POINTS_MAX, 4 * POINTS_MAX)
    assert len(shown._nodes._cloud.points) == POINTS_MAX
    before = shown._nodes._cloud.points.copy()
    camera.position, camera.look_at = np.array([0.0, 0.0, 0.0]), np.array([0.0, 2.0, 0.0])
    shown.camera_moved()
    sent.wait_for(2)
    after = shown._nodes._cloud.points
    assert len(after) == POINTS_MAX
    # Denser where the camera looks now.
    ahead = [int((points[:, 1] >= np.abs(points).max(axis=1)).sum()) for points in (before, after)]
    assert ahead[1] > 2 * ahead[0]


def test_a_map_that_never_stops_growing_is_seen(
    stage: tuple[VisualStage, Camera, Sent], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(visual_stage, "_OVERDUE_S", 0.3)
    shown, _, sent = stage
    shown.draw(picture(10), is_new=True)
    shown.show(ALL, is_dark=False, is_seen=True)
    until_s = time.monotonic() + 2.0
    count = 10
    while time.monotonic() < until_s:
        count += 10
        shown.draw(picture(count), is_new=False)
        time.sleep(0.05)
    assert len(sent) >= 2
    assert comes_true(lambda: sent[-1] == (count, count))


def test_what_is_hidden_is_not_sent(stage: tuple[VisualStage, Camera, Sent]) -> None:
    shown, _, sent = stage
    shown.show(ALL - {"cloud"}, is_dark=False, is_seen=True)
    shown.draw(picture(100), is_new=True)
    assert shown._sending.wait(ENOUGH_S)
    assert not sent
    shown.show(ALL, is_dark=False, is_seen=True)
    sent.wait_for(1)
    boxes = Boxes(
        middles_m=np.zeros((1, 3), np.float32),
        sizes_m=np.ones(1, np.float32),
        rgb=np.zeros((1, 3), np.uint8),
    )
    shown.draw_boxes(boxes)
    assert not shown._nodes._cloud.visible
    shown.camera_moved()
    assert shown._sending.wait(ENOUGH_S)
    assert len(sent) == 1
    shown.draw_boxes(None)
    sent.wait_for(2)
    assert shown._nodes._cloud.visible


def test_a_camera_that_nobody_moved_keeps_up_with_the_map(
    stage: tuple[VisualStage, Camera, Sent],
) -> None:
    shown, camera, _ = stage
    shown.draw(picture(100), is_new=True)
    shown.show(ALL, is_dark=True, is_seen=True)
    near = np.linalg.norm(camera.position)
    grown = picture(100)
    larger = VisualPicture(
        path_m=grown.path_m,
        T_map_keyframe=grown.T_map_keyframe,
        loops=grown.loops,
        points_m=3.0 * grown.points_m,
        rgb=grown.rgb,
    )
    shown.draw(larger, is_new=False)
    far = np.linalg.norm(camera.position)
    assert far > 2.0 * near
    camera.position = camera.position + 0.5
    moved = camera.position.copy()
    shown.draw(picture(50), is_new=False)
    shown.draw(larger, is_new=False)
    np.testing.assert_array_equal(camera.position, moved)


def test_clicks_mean_keyframes_before_the_floor(stage: tuple[VisualStage, Camera, Sent]) -> None:
    shown, _, _ = stage
    keyframes: list[int] = []
    places: list[Any] = []
    shown.on_keyframe, shown.on_place = keyframes.append, places.append
    shown.draw(picture(10), is_new=True)
    above, down = np.array([0.04, 0.0, 2.0]), np.array([0.0, 0.0, -1.0])
    shown.clicked(above, down)
    assert not keyframes, "nothing is seen yet"
    shown.show(ALL, is_dark=False, is_seen=True)
    shown.clicked(above, down)
    assert keyframes == [0]
    assert not places
    shown.show(ALL - {"keyframes"}, is_dark=False, is_seen=True)
    shown.clicked(above, down)
    assert keyframes == [0]
    np.testing.assert_allclose(places, [[0.04, 0.0]])


def test_the_last_loop_is_named_where_it_was_closed(stage, server) -> None:
    shown, _, _ = stage
    shown.show(ALL, is_dark=False, is_seen=True)
    alone = picture(10)
    shown.draw(alone, is_new=True)
    label = server.scene.get_handle_by_name("/visual/last_loop")
    assert not label.visible
    T_map_keyframe = np.tile(np.eye(4), (4, 1, 1))
    T_map_keyframe[:, 0, 3] = 0.0, 1.0, 2.0, 3.0
    loops = np.array([[0, 2], [1, 3]])
    shown.draw(replace(alone, T_map_keyframe=T_map_keyframe, loops=loops), is_new=False)
    assert label.visible
    assert label.text == "loop 2"
    assert label.position[0] == 2.0
    shown.show(ALL - {"loops"}, is_dark=False, is_seen=True)
    assert not label.visible


def test_the_way_of_the_camera_is_seen_whole(stage) -> None:
    shown, camera, _ = stage
    shown.show(ALL, is_dark=False, is_seen=True)
    seen = picture(1000)
    shown.draw(seen, is_new=True)
    # One place among a thousand points, far from all others.
    far = np.concatenate([seen.path_m, [[0.0, 40.0, 0.0]]])
    shown.draw(replace(seen, path_m=far), is_new=True)
    assert camera.look_at[1] == pytest.approx(0.5 * (40.0 - 2.0), abs=0.3)
