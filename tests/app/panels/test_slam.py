"""Motion and SLAM in the Map panel on a real server, worked by clients that speak viser's
protocol."""

import html
import io
import re
import shlex
import threading
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import viser

from fusion_core.model.errors import MissingStream
from fusion_core.model.grids import OccupancyGrid
from fusion_core.workflows.map.result_folder import TrajectoryPoses
from fusion_core.workflows.recorded_poses import PoseLookup
from scanloom.client_session import ClientSession
from scanloom.jobs import slam_run as job
from scanloom.panels import slam as slam_panel
from scanloom.panels.map import MapPanel
from scanloom.panels.visual_stage import VisualStage
from scanloom.plots.line_plot import css
from scanloom.plots.theme import DARK, LIGHT
from scanloom.state.library import Library
from scanloom.state.slam_choices import SlamChoices
from scanloom.state.slam_runs import MAX_RUNS
from scanloom.state.view import View, view_of_link
from tests.app.slam_runs import SCANS, FakeMap, view_at
from tests.app.viser_client import ViserClient, Widget, connect
from tests.patience import ENOUGH_S

FIRST = "1: lidar, recorded, pose-graph"


class Page:
    """One browser with a session that has the Map panel alone, in its mode SLAM."""

    def __init__(self, client: viser.ClientHandle, library: Library, root: Path) -> None:
        self.floor: list[tuple[OccupancyGrid | None, PoseLookup | None]] = []
        self.client: ViserClient
        view = View(recording=next(iter(library.named())), panel="Map", map_mode="SLAM")
        self.session = ClientSession(client, library, view)
        self.stage = VisualStage(client, self.session)
        self.panel = MapPanel(client.gui, self.session, root, self.take, lambda _: None, self.stage)
        self.session.panels = [self.panel]
        self.session.refresh()

    def take(self, grid: OccupancyGrid | None, poses: PoseLookup | None, _: object) -> None:
        self.floor.append((grid, poses))

    def close(self) -> None:
        self.panel.close()
        self.stage.close()
        self.session.close()
        self.client.close()

    def until(self, condition: Callable[[], bool]) -> None:
        self.client.wait_until(condition)

    def says(self, words: str) -> bool:
        return any(
            words in html.unescape(str(widget.props.get("content", ""))) and widget.props["visible"]
            for widget in list(self.client.widgets.values())
        )

    def until_says(self, words: str) -> None:
        self.until(lambda: self.says(words))

    def widget(self, label: str) -> Widget:
        return self.client.find(label)

    def pictures(self) -> list[Widget]:
        """Live and its effective number; a run, its effective number and weights; both, apart."""
        kinds = "GuiImageMessage", "GuiUplotMessage"
        found = [w for w in list(self.client.widgets.values()) if w.type in kinds]
        # The first belongs to the other mode; keyframes are those of visual SLAM.
        return [w for w in found[1:] if "Keyframes" not in self.client.around(w)]

    def frame_view(self) -> list[bool]:
        return [bool(picture.props["visible"]) for picture in self.pictures()]

    def command(self) -> list[str]:
        (content,) = (
            str(widget.props["content"])
            for widget in list(self.client.widgets.values())
            if "scanloom map" in str(widget.props.get("content", ""))
        )
        field = re.search(r"<textarea readonly[^>]*>(.*?)</textarea>", content, re.DOTALL)
        assert field is not None
        return shlex.split(html.unescape(field[1]))

    def run(self, name: str, **choices: Any) -> None:
        """Choose, run, and wait for the end."""
        for label, value in choices.items():
            self.client.set_value(label, value)
            # A click may overtake it.
            self.until(lambda: value in dict(self.session.view.slam).values())  # noqa: B023  # waited for at once
        self.until(lambda: not self.widget("Run").props["disabled"])
        self.client.click("Run")
        self.until(lambda: name in self.widget("Run shown").props["options"])
        self.until(lambda: not self.widget("Run").props["disabled"])


class Bench:
    """A server; each browser that connects gets a page of its own."""

    def __init__(self, recording: Path, root: Path) -> None:
        self.root = root
        self.library = Library([recording], [])
        self.pages: list[Page] = []
        self.furnished = threading.Semaphore(0)
        self.server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        self.server.on_client_connect(self._welcome)

    def _welcome(self, client: viser.ClientHandle) -> None:
        self.pages.append(Page(client, self.library, self.root))
        self.furnished.release()

    def arrive(self) -> Page:
        client = connect(f"http://127.0.0.1:{self.server.get_port()}")
        assert self.furnished.acquire(timeout=ENOUGH_S)
        self.pages[-1].client = client
        self.pages[-1].until_says("scanloom map")
        return self.pages[-1]

    def close(self) -> None:
        for page in self.pages:
            page.close()
        self.server.stop()
        self.library.close()


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakeMap:
    fake = FakeMap()
    monkeypatch.setattr(job, "build_map", fake)
    return fake


@pytest.fixture
def bench(small_scene: Path, tmp_path: Path, fake: FakeMap) -> Iterator[Bench]:
    bench = Bench(small_scene, tmp_path / "<b>root & more")
    yield bench
    bench.close()


@pytest.fixture
def page(bench: Bench) -> Page:
    return bench.arrive()


class Gate:
    """Holds a run at one of its scans until it is let on."""

    def __init__(self, fake: FakeMap, scan: int) -> None:
        self.begun, self.go_on = threading.Event(), threading.Event()
        self._scan = scan
        fake.at_scan = self._wait

    def _wait(self, number: int) -> None:
        if number == self._scan:
            self.begun.set()
            assert self.go_on.wait(ENOUGH_S)


def test_a_run_shows_its_map_its_report_and_its_floor(page: Page, bench: Bench) -> None:
    assert not any(page.frame_view())
    assert len(page.frame_view()) == 8
    assert not page.widget("Result").props["visible"]
    page.run(FIRST)
    page.until_says("83.3 % of the scans")
    page.until_says("2.0 s to 2.9 s: 10 scans do not fit the map")
    page.until_says("2 closed, 1 dropped")
    page.until_says("local slam 2 s")
    # What a recording has in its names is no markup.
    assert not any("<b>& more" in str(w.props.get("content")) for w in page.client.widgets.values())
    assert page.widget("Result").props["visible"]
    assert not page.widget("Two runs side by side").props["visible"]
    page.until(lambda: page.frame_view() == [False, False, True, *[False] * 5])
    page.until(lambda: len(page.floor) == 1)
    grid, poses = page.floor[-1]
    assert grid is not None
    assert isinstance(poses, TrajectoryPoses)
    assert poses.source == FIRST
    # Fusing has no map yet.
    page.client.set_value("Mode", "Fuse")
    page.until(lambda: page.floor[-1] == (None, None))
    assert page.command()[:2] == ["scanloom", "map"]


def test_the_panel_moves_while_it_runs(page: Page, fake: FakeMap) -> None:
    gate = Gate(fake, SCANS // 2)
    page.client.set_value("SLAM", "particle-filter")
    page.until(lambda: page.widget("Particles").props["visible"])
    page.client.click("Run")
    assert gate.begun.wait(ENOUGH_S)
    page.until(lambda: page.frame_view()[0] and page.frame_view()[1])
    assert page.widget("Run").props["disabled"]
    page.until_says("Matching scans")
    gate.go_on.set()
    page.until(
        lambda: (
            "1: lidar, recorded, particle-filter (30)" in page.widget("Run shown").props["options"]
        )
    )
    page.until(lambda: page.frame_view()[:4] == [False, False, True, True])
    page.until_says("least effective number 3.0 at 1.5 s")


def test_cancel_and_run_again(page: Page, fake: FakeMap) -> None:
    gate = Gate(fake, 10)
    page.client.click("Run")
    assert gate.begun.wait(ENOUGH_S)
    # What a browser sends all the same begins no second run.
    page.panel._slam._begin()
    page.client.click("Cancel run")
    page.until_says("Stopping at the next step")
    gate.go_on.set()
    page.until_says("Cancelled; nothing was saved.")
    page.until(lambda: not page.widget("Run").props["disabled"])
    assert not page.widget("Cancel run").props["visible"]
    assert len(fake.calls) == 1
    page.run("2: lidar, recorded, pose-graph")
    assert list(page.widget("Run shown").props["options"]) == ["2: lidar, recorded, pose-graph"]


def test_a_failure_is_reported_with_advice_and_the_panel_goes_on(
    page: Page, fake: FakeMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*args: Any) -> Any:
        raise MissingStream("<i>holds no scan.", file="a/room", advice="Take another one.")

    monkeypatch.setattr(job, "build_map", fail)
    page.client.click("Run")
    page.until_says("Failed: room: <i>holds no scan. Take another one.")
    told = page.client.wait_for(lambda got: got.type == "NotificationShowMessage")
    assert told.message["props"]["title"] == "room: <i>holds no scan."
    assert told.message["props"]["body"] == "Take another one."
    assert not any("<i>" in str(w.props.get("content")) for w in page.client.widgets.values())
    monkeypatch.setattr(job, "build_map", fake)
    page.run("2: lidar, recorded, pose-graph")
    assert not page.says("Failed")


def test_a_run_that_does_not_fit_is_shown_with_a_warning(page: Page, fake: FakeMap) -> None:
    fake.fits = False
    page.run(FIRST)
    page.until_says("Not reliable:")
    page.client.wait_for(lambda got: got.type == "NotificationShowMessage")
    page.until(lambda: page.frame_view()[2])


def test_what_cannot_be_done_is_reported_and_not_begun(page: Page, fake: FakeMap) -> None:
    page.client.set_value("Motion", "none")
    page.client.set_value("SLAM", "none")
    page.until_says("Without SLAM and without motion there are no poses")
    page.until(lambda: bool(page.widget("Run").props["disabled"]))
    page.panel._slam._begin()
    assert not page.panel._slam._job.is_running
    page.client.set_value("SLAM", "pose-graph")
    page.until(lambda: not page.says("there are no poses"))
    page.until(lambda: not page.widget("Run").props["disabled"])
    assert fake.calls == []


def test_two_runs_side_by_side(page: Page, fake: FakeMap) -> None:
    page.run(FIRST)
    fake.shift_m = 0.3
    page.run("2: lidar, fused, particle-filter (30)", SLAM="particle-filter", Motion="fused")
    page.until(lambda: all(page.frame_view()[2:]))
    # It drifts steadily: half of the path has half of the most.
    page.until_says("15.0 cm in the median, at most 30.0 cm, 5.9 s later")
    # Each with itself.
    page.client.set_value("A", "2: lidar, fused, particle-filter (30)")
    page.until_says("0.0 cm in the median, at most 0.0 cm")
    results = page.panel._slam._results
    assert tuple(results._both.image[3, 3]) == LIGHT.background
    page.session.change(color_scheme="dark")
    page.until(lambda: tuple(results._both.image[3, 3]) == DARK.background)
    axes = results._distance.axes
    assert axes is not None
    assert {axis["stroke"] for axis in axes} == {css(DARK.ink)}
    page.client.set_value("Run shown", FIRST)
    page.until_says("2 closed, 1 dropped")
    page.until(lambda: page.frame_view()[2:6] == [True, False, False, False])
    page.until(
        lambda: isinstance(page.floor[-1][1], TrajectoryPoses) and page.floor[-1][1].source == FIRST
    )


@pytest.mark.slow
def test_the_oldest_goes_with_a_note(page: Page, fake: FakeMap) -> None:
    for number in range(1, MAX_RUNS + 2):
        page.run(f"{number}: lidar, recorded, pose-graph")
    page.until_says(f"Run 1 was deleted: the last {MAX_RUNS} are kept.")
    offered = page.widget("Run shown").props["options"]
    assert [int(name.split(":")[0]) for name in offered] == list(range(2, MAX_RUNS + 2))
    folders = [call[1].parent for call in fake.calls]
    assert [folder.exists() for folder in folders] == [False, *[True] * MAX_RUNS]


def test_download_save_and_command(page: Page, bench: Bench) -> None:
    page.run("1: lidar, recorded, particle-filter (31)", SLAM="particle-filter", Particles=31)
    folder = bench.root / "small_room"
    expected = ["--scan=lidar", "--motion=recorded", "--slam=particle-filter"]
    page.until(lambda: page.command()[5:8] == expected)
    assert page.command()[4] == str(folder / "results")
    page.client.drain()
    page.client.click("Download run (.zip)")
    part = page.client.wait_for(lambda got: got.type == "FileTransferPart")
    with zipfile.ZipFile(io.BytesIO(part.message["content"])) as archive:
        names = {Path(name).name for name in archive.namelist()}
    assert names == {
        "map_lidar.pgm",
        "map_lidar.yaml",
        "trajectory.png",
        "trajectory.tum",
        "report.json",
    }
    page.client.click("Save to the output folder")
    page.until_says(str(folder))
    page.until(lambda: (folder / "results" / "trajectory.tum").exists())
    # Once is enough.
    page.client.click("Save to the output folder")
    page.until(lambda: page.command()[4] == str(folder / "results"))
    assert [path.name for path in bench.root.iterdir()] == ["small_room"]
    page.client.set_value("Scan", "merged")
    page.until(lambda: "--scan=merged" in page.command())
    assert page.command()[4] == str(bench.root / "small_room-2" / "results")


def test_each_browser_has_its_own_runs_and_takes_them_along(bench: Bench, fake: FakeMap) -> None:
    ann, bob = bench.arrive(), bench.arrive()
    ann.run(FIRST)
    bob.run("1: camera, recorded, pose-graph", Scan="camera")
    assert list(ann.widget("Run shown").props["options"]) == [FIRST]
    assert list(bob.widget("Run shown").props["options"]) == ["1: camera, recorded, pose-graph"]
    folders = [output.parent for _, output, _ in fake.calls]
    ann.panel.close()
    assert [folder.exists() for folder in folders] == [False, True]
    bob.panel.close()
    assert not folders[1].parent.exists()


def test_closing_cancels_and_clears_away(page: Page, fake: FakeMap) -> None:
    gate = Gate(fake, 10)
    page.client.click("Run")
    assert gate.begun.wait(ENOUGH_S)
    with page.panel._slam._lock:
        job_at_work, folder = page.panel._slam._job._job, page.panel._slam._folder
    assert job_at_work is not None
    assert folder is not None
    closing = threading.Thread(target=page.panel.close)
    closing.start()
    assert job_at_work._stop.wait(ENOUGH_S)
    gate.go_on.set()
    closing.join(ENOUGH_S)
    assert not folder.exists()
    page.panel._slam._begin()
    assert not page.panel._slam._job.is_running, "who has gone begins nothing"


def test_pictures_come_a_few_times_a_second(
    page: Page, fake: FakeMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter(range(10_000))
    # Each look at the clock is 10 ms after the one before.
    monkeypatch.setattr(slam_panel, "time", SimpleNamespace(monotonic=lambda: 0.01 * next(clock)))
    asked: list[int] = []
    panel = page.panel._slam

    class Noted:
        def submit(self, seen: Any) -> None:
            asked.append(len(seen.stamps_ns))

    monkeypatch.setattr(panel, "_live", Noted())
    options = job.map_options(page.session.view, Path("settings.toml"))
    for number in range(1, SCANS + 1):
        panel._observe(view_at(number, "matching scans", options))
    assert asked == [21, 41]


def test_choices_are_in_the_link_of_the_view(page: Page) -> None:
    page.client.set_value("Scan", "repaired")
    page.client.set_value("SLAM", "particle-filter")
    page.client.set_value("Particles", 50)
    chosen = SlamChoices(scan="repaired", estimator="particle-filter", particles=50)
    page.until(lambda: page.session.view.slam == chosen)
    restored = view_of_link(page.session.view.to_link())
    assert (restored.slam, restored.map_mode) == (chosen, "SLAM")
