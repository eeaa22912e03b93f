"""The scene's panel on a small recording: its legend, its viewpoints, and what is pointed at."""

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import viser

from fusion_core.model.classes import NoiseClass
from fusion_core.model.grids import OccupancyGrid
from scanloom.client_session import ClientSession
from scanloom.page.bridge import PageBridge
from scanloom.panels.scene import ScenePanel
from scanloom.panels.scene_legend import legend_entries, legend_html
from scanloom.plots.theme import DARK, LIGHT
from scanloom.scene.layers import LAYERS, layers_of_step
from scanloom.state.hover import Hover
from scanloom.state.library import Library
from scanloom.state.view import PANELS, View, view_of_link
from tests.app.viser_client import CAMERA, Received, ViserClient, connect
from tests.patience import ENOUGH_S

MOVES = {"SetCameraPositionMessage"}


@dataclass(frozen=True)
class Bench:
    """A browser at a session with nothing but the scene."""

    session: ClientSession
    panel: ScenePanel
    browser: ViserClient

    def change(self, **values: object) -> list[Received]:
        """Change the view; return what the browser was sent until it was shown."""
        self.browser.drain()
        self.session.change(**values)
        assert self.session.wait(ENOUGH_S)
        return self.sent()

    def sent(self) -> list[Received]:
        """What the browser was sent up to now and was not taken yet."""
        mark = self.session._client.gui.add_html("<i>mark</i>")
        taken = []
        while True:
            received = self.browser.receive()
            taken.append(received)
            if received.message.get("uuid") == mark._impl.uuid:
                break
        mark.remove()
        return taken


@pytest.fixture(scope="module")
def module_bench(small_scene: Path) -> Iterator[Bench]:
    library = Library([small_scene], [])
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    built: list[tuple[ClientSession, ScenePanel]] = []
    ready = threading.Event()

    @server.on_client_connect
    def _(client: viser.ClientHandle) -> None:
        session = ClientSession(client, library, View(recording=next(iter(library.named()))))
        bridge = PageBridge(client.gui)
        panel = ScenePanel(client, bridge, session)
        session.panels = [panel]
        session.refresh()
        built.append((session, panel))
        ready.set()

    with connect(f"http://127.0.0.1:{server.get_port()}") as browser:
        assert ready.wait(ENOUGH_S)
        session, panel = built[0]
        browser.wait_until(
            lambda: session.frame_view is not None and session.frame_view.fused is not None,
            ENOUGH_S,
        )
        assert session.wait(ENOUGH_S)
        yield Bench(session, panel, browser)
        session.close()
    server.stop()
    library.close()


@pytest.fixture
def bench(module_bench: Bench) -> Bench:
    """The bench as at the start."""
    module_bench.change(
        panel="Recording",
        frame_index=0,
        hidden_layers=frozenset(),
        visible_classes=frozenset(NoiseClass),
        color_scheme="light",
    )
    return module_bench


def moves(sent: list[Received]) -> int:
    return sum(received.type in MOVES for received in sent)


def test_a_step_moves_the_camera_and_a_frame_does_not(bench: Bench) -> None:
    for step in ("Match", "Register", "Repair", "Map", "Recording"):
        assert moves(bench.change(panel=step)) == 1
        assert moves(bench.change(frame_index=bench.session.view.frame_index + 1)) == 0
    assert moves(bench.change(hidden_layers=frozenset({"rays"}))) == 0
    bench.panel.viewpoint.reset()
    assert moves(bench.sent()) == 1


def test_keys_go_to_the_viewpoints(bench: Bench) -> None:
    bench.change(panel="Match")
    camera = bench.session._client.camera
    places = {}
    for name in ("From above", "As the camera", "Reset view"):
        bench.browser.drain()
        bench.browser.trigger(name)
        bench.browser.wait_for(lambda received: received.type in MOVES)
        places[name] = tuple(map(float, camera.position))
    assert len(set(places.values())) == 3
    assert places["From above"][2] == max(place[2] for place in places.values())


def test_a_screen_of_another_shape_is_fitted_unless_a_person_has_moved(bench: Bench) -> None:
    bench.change(panel="Match")
    camera = bench.session._client.camera

    def tell(width_px: int, beside_m: float) -> None:
        x_m, y_m, z_m = map(float, camera.position)
        told = CAMERA | {
            "position": (x_m + beside_m, y_m, z_m),
            "look_at": tuple(float(value) for value in camera.look_at),
            "fov": float(camera.fov),
            "image_width": width_px,
        }
        bench.browser.drain()
        bench.browser.send(told)
        bench.browser.wait_until(lambda: camera.image_width == width_px)

    tell(600, 0.0)
    bench.browser.wait_for(lambda received: received.type in MOVES)
    tell(1200, 0.5)
    assert moves(bench.sent()) == 0
    tell(600, 0.0)
    assert moves(bench.sent()) == 0
    bench.panel.viewpoint.reset()
    tell(1280, 0.0)
    bench.browser.wait_for(lambda received: received.type in MOVES)


def test_what_a_browser_tells_of_the_place_it_has_left_turns_nothing(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = bench.session._client.camera
    bench.change(panel="Map")
    left_m = tuple(map(float, camera.position))
    bench.change(panel="Match")
    arrived_m = tuple(map(float, camera.position))
    assert arrived_m != left_m
    faced: list[tuple[float, ...]] = []
    monkeypatch.setattr(
        bench.panel._nodes, "face", lambda view: faced.append(tuple(map(float, view.position_m)))
    )

    def tell(position_m: tuple[float, ...]) -> None:
        look_at = tuple(float(value) for value in camera.look_at)
        bench.browser.send(CAMERA | {"position": position_m, "look_at": look_at})
        bench.browser.wait_until(lambda: tuple(map(float, camera.position)) == position_m)

    tell(left_m)
    tell(arrived_m)
    bench.browser.wait_until(lambda: arrived_m in faced)
    assert left_m not in faced
    # A person who goes there is followed.
    tell(left_m)
    bench.browser.wait_until(lambda: left_m in faced)


def test_a_page_that_tells_its_size_is_fitted_to_what_its_panels_leave(bench: Bench) -> None:
    session = bench.session
    bench.change(panel="Match")
    first_px, z_m = session.window_px, float(session._client.camera.position[2])
    try:
        session.window_px = (1280, 720)
        assert moves(bench.change(row_step=7)) == 1
        assert float(session._client.camera.position[2]) != z_m
        assert moves(bench.change(row_step=8)) == 0
    finally:
        session.window_px = first_px


def test_each_step_has_its_layers_and_each_layer_a_step() -> None:
    for step in PANELS:
        shown = layers_of_step(step, frozenset())
        assert "curve" in shown
        assert layers_of_step(step, frozenset({"curve"})) == shown - {"curve"}
    assert all(info.steps and info.help for info in LAYERS.values())
    assert "classes" in layers_of_step("Repair", frozenset())
    assert "map" not in layers_of_step("Repair", frozenset())


def test_the_legend_is_the_switch_of_each_layer(bench: Bench) -> None:
    session = bench.session
    curve = session._client.scene.get_handle_by_name("/frame/curve")
    assert curve.visible
    bench.browser.press("layer", "LiDAR curve")
    bench.browser.wait_until(lambda: "curve" in session.view.hidden_layers)
    assert session.wait(ENOUGH_S)
    assert not curve.visible
    entries = legend_entries(session, session.view.panel, session.view, is_dark=False)
    shown = {entry.label: entry.is_visible for entry in entries}
    assert not shown["LiDAR curve"]
    assert shown["Depth surface"]
    assert view_of_link(session.view.to_link()).hidden_layers == {"curve"}
    bench.browser.press("layer", "LiDAR curve")
    bench.browser.wait_until(lambda: not session.view.hidden_layers)
    bench.browser.press("layer", "no such layer")
    assert session.wait(ENOUGH_S)
    assert curve.visible


def test_classes_are_switched_one_by_one(bench: Bench) -> None:
    bench.change(panel="Repair")
    entries = legend_entries(bench.session, "Repair", bench.session.view, is_dark=False)
    labels = {entry.label for entry in entries}
    assert {"Good", "Hole", "Burr", "Conflict"} <= labels
    bench.browser.press("layer", "Hole")
    bench.browser.wait_until(lambda: NoiseClass.HOLE not in bench.session.view.visible_classes)


@pytest.mark.parametrize("step", PANELS)
def test_a_legend_names_each_layer_with_its_shape(bench: Bench, step) -> None:
    view = View(recording="x", hidden_layers=frozenset({"curve"}))
    entries = legend_entries(bench.session, step, view, is_dark=False)
    written = legend_html(entries, is_dark=True)
    assert written.count("<button") == written.count("<svg") == len(entries)
    assert written.count('aria-pressed="false"') == 1
    assert 'class="scanloom-legend dark"' in written


def test_what_is_pointed_at_lights_up(bench: Bench) -> None:
    session = bench.session
    match = session.frame_view.match
    pairs = match.correspondence
    found = np.flatnonzero(np.isfinite(pairs.lidar_range_m) & np.isfinite(pairs.depth_m))[0]
    hover = session._client.scene.get_handle_by_name("/frame/hover")
    row, column = int(pairs.row[found]), int(pairs.column[found])
    session.hover(Hover(source="depth", row=row, column=column))
    bench.browser.wait_until(lambda: hover.visible)
    session.hover(Hover())
    bench.browser.wait_until(lambda: not hover.visible)


def test_a_dark_page_has_a_dark_scene(bench: Bench) -> None:
    floor = bench.session._client.scene.get_handle_by_name("/floor")
    light = tuple(floor.cell_color)
    bench.change(color_scheme="dark")
    assert sum(floor.cell_color) < sum(light)


def test_the_map_is_drawn_for_the_theme(bench: Bench) -> None:
    grid = OccupancyGrid(resolution_m=0.05, origin_m=(0.0, 0.0), log_odds=np.full((4, 6), np.nan))
    bench.panel.set_map(grid)
    drawn = bench.session._client.scene.get_handle_by_name("/in_map/map")
    for scheme, theme in (("dark", DARK), ("light", LIGHT)):
        bench.change(color_scheme=scheme)
        assert tuple(drawn.image[0, 0]) == theme.unknown
    bench.panel.set_map(None)


def test_cells_of_the_map_stand_out_until_another_map(bench: Bench) -> None:
    grid = OccupancyGrid(resolution_m=0.05, origin_m=(0.0, 0.0), log_odds=np.full((4, 6), np.nan))
    node = bench.session._client.scene.get_handle_by_name
    bench.panel.set_map(grid, None, np.array([[0.02, 0.02], [0.12, 0.07]]))
    assert node("/in_map/differing").visible
    assert node("/in_map/differing").points.shape == (8, 2, 3)
    bench.panel.mark_cell(np.array([0.12, 0.07]))
    assert node("/in_map/cell").visible
    # The theme draws the same map anew.
    bench.change(color_scheme="dark")
    assert node("/in_map/differing").visible
    bench.panel.set_map(grid)
    assert not node("/in_map/differing").visible
    assert not node("/in_map/cell").visible
    bench.panel.set_map(None)
