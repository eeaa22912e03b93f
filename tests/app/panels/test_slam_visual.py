"""Visual SLAM in the Map panel on a real server, worked by a client of viser's protocol."""

import html
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import viser

from fusion_core.workflows.convert import ConvertOptions, convert
from scanloom.client_session import ClientSession
from scanloom.jobs import slam_run as job
from scanloom.panels.map import MapPanel
from scanloom.panels.slam_visual import live_text, points_text
from scanloom.panels.visual_stage import VisualStage
from scanloom.state.library import Library
from scanloom.state.slam_choices import SlamChoices
from scanloom.state.view import View
from tests.app.viser_client import ViserClient, connect
from tests.app.visual_runs import EVERY, FakeVisualMap, forward
from tests.patience import ENOUGH_S

RUN = "1: visual"


class Page:
    """One browser with a session that has the Map panel and the stage, and its server."""

    def __init__(self, recording: Path, root: Path, estimator: str = "visual") -> None:
        self.library = Library([recording], [])
        self.estimator, self.root = estimator, root
        self.furnished = threading.Event()
        self.server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        self.server.on_client_connect(self._welcome)
        self.client: ViserClient = connect(f"http://127.0.0.1:{self.server.get_port()}")
        assert self.furnished.wait(ENOUGH_S)
        self.until_says("scanloom map")

    def _welcome(self, client: viser.ClientHandle) -> None:
        view = View(
            recording=next(iter(self.library.named())),
            panel="Map",
            map_mode="SLAM",
            slam=SlamChoices.model_validate({"estimator": self.estimator}),
        )
        self.session = ClientSession(client, self.library, view)
        self.stage = VisualStage(client, self.session)
        self.panel = MapPanel(
            client.gui, self.session, self.root, lambda *_: None, lambda _: None, self.stage
        )
        self.session.panels = [self.panel]
        self.session.refresh()
        self.furnished.set()

    def close(self) -> None:
        self.panel.close()
        self.stage.close()
        self.session.close()
        self.client.close()
        self.server.stop()
        self.library.close()

    def until(self, condition: Callable[[], bool]) -> None:
        self.client.wait_until(condition)

    def says(self, words: str) -> bool:
        return any(
            words in html.unescape(str(widget.props.get("content", "")))
            and bool(widget.props["visible"])
            for widget in list(self.client.widgets.values())
        )

    def until_says(self, words: str) -> None:
        self.until(lambda: self.says(words))

    def run(self) -> None:
        self.until(lambda: not self.client.find("Run").props["disabled"])
        self.client.click("Run")

    def run_to_end(self) -> None:
        self.run()
        self.until(lambda: RUN in self.client.find("Run shown").props["options"])
        self.until_says("Both see")


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakeVisualMap:
    fake = FakeVisualMap(forward, within_m=10.0)
    monkeypatch.setattr(job, "build_map", fake)
    return fake


@pytest.fixture
def page(small_scene: Path, tmp_path: Path, fake: FakeVisualMap) -> Iterator[Page]:
    page = Page(small_scene, tmp_path)
    yield page
    page.close()


def test_the_map_grows_while_it_works_and_can_be_cancelled(page: Page, fake: FakeVisualMap) -> None:
    begun, go_on = threading.Event(), threading.Event()

    def wait(number: int) -> None:
        if number == 1:
            begun.set()
            assert go_on.wait(ENOUGH_S)

    fake.at_keyframe = wait
    page.run()
    assert begun.wait(ENOUGH_S)
    page.until(lambda: page.stage.has_map)
    page.until_says("1 image placed, 1 keyframe, 0 loops closed.")
    assert page.stage._nodes._path._handle is not None
    page.client.click("Cancel run")
    go_on.set()
    page.until_says("Cancelled; nothing was saved.")
    page.until(lambda: not page.stage.has_map)


def test_a_run_ends_with_its_keyframes_and_what_they_share(page: Page) -> None:
    page.run_to_end()
    assert page.stage.has_map
    for words in (
        "keyframes  ",
        "lost       0.2 s to 0.3 s: 3 images, too few matches",
        "jump       0.61 m",
        "<b>& more",
    ):
        assert page.says(words), words
    # Names are text, wherever they come from.
    assert not any("<b>& more" in str(w.props.get("content")) for w in page.client.widgets.values())
    run = page.panel._slam.chosen(page.session.view.recording)
    assert run is not None
    assert run.visual is not None
    first, second = (int(page.client.find(name).value) for name in ("Keyframe", "Compared with"))
    shared = len(run.visual.matches(first - 1, second - 1)[0])
    assert shared > 0
    assert page.says(f"Both see {shared} landmark")
    assert run.visual.shared_counts(first - 1).max() == shared
    page.client.set_value("Keyframe", 1)
    page.until(lambda: int(page.client.find("Compared with").value) == 2)
    page.client.set_value("Compared with", 1)
    page.until_says("Keyframe 1 alone")


def test_a_click_on_a_keyframe_chooses_it(page: Page) -> None:
    page.run_to_end()
    page.stage.show(frozenset({"keyframes", "cloud"}), is_dark=False, is_seen=True)
    at = forward(EVERY)[:3, 3]
    above = np.array([at[0] + 0.04, at[1], at[2] + 3.0])
    page.stage.clicked(above, np.array([0.0, 0.0, -1.0]))
    page.until(lambda: int(page.client.find("Keyframe").value) == 2)
    # Of no keyframe there is nothing to show.
    page.stage.clicked(above, np.array([0.0, 0.0, 1.0]))
    assert int(page.client.find("Keyframe").value) == 2


def test_without_colour_it_says_why_not(small_scene: Path, tmp_path: Path) -> None:
    topics = ["/scan", "/odom", "/tf", "/tf_static"]
    path = tmp_path / "lidar.mcap"
    convert(small_scene, path, ConvertOptions(topics=topics), lambda *_: None)
    page = Page(path, tmp_path)
    try:
        page.until_says("SLAM “visual” needs colour images and depth images, which this recording")
        assert page.client.find("Run").props["disabled"]
        page.client.click("Choose what this recording allows")
        page.until(lambda: page.session.view.slam.estimator == "pose-graph")
        page.until(lambda: not page.client.find("Run").props["disabled"])
    finally:
        page.close()


def test_what_is_said_of_a_run() -> None:
    assert points_text(5, 5) == "All 5 points of the cloud are drawn."
    assert "200,000 of the 1,500,000 points" in points_text(200_000, 1_500_000)
    assert live_text.__doc__
