"""The Map panel on a real server, worked by a client that speaks viser's protocol."""

import html
import re
import shlex
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import viser

from fusion_core.model.errors import ExportError
from fusion_core.model.grids import OccupancyGrid
from scanloom.client_session import ClientSession
from scanloom.jobs.long_job import Cancelled
from scanloom.panels import map as map_panel
from scanloom.panels.map import MapPanel
from scanloom.panels.visual_stage import VisualStage
from scanloom.state.library import Library
from scanloom.state.view import View
from tests.app.viser_client import ViserClient, Widget, connect
from tests.patience import ENOUGH_S


class Bench:
    """A server whose one browser has a session with the Map panel alone."""

    def __init__(self, recording: Path, root: Path) -> None:
        self.root = root
        self.library = Library([recording], [])
        self.floor: list[OccupancyGrid | None] = []
        self.furnished = threading.Event()
        self.server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        self.server.on_client_connect(self._welcome)
        self.client: ViserClient = connect(f"http://127.0.0.1:{self.server.get_port()}")
        assert self.furnished.wait(ENOUGH_S)

    def _welcome(self, client: viser.ClientHandle) -> None:
        view = View(recording=next(iter(self.library.named())), panel="Map")
        self.session = ClientSession(client, self.library, view)
        self.stage = VisualStage(client, self.session)
        self.panel = MapPanel(
            client.gui, self.session, self.root, self._take, lambda _: None, self.stage
        )
        self.session.panels = [self.panel]
        self.session.refresh()
        self.furnished.set()

    def _take(self, grid: OccupancyGrid | None, *_: object) -> None:
        self.floor.append(grid)

    def close(self) -> None:
        self.panel.close()
        self.stage.close()
        self.session.close()
        self.client.close()
        self.server.stop()
        self.library.close()

    def html(self, words: str) -> Widget:
        """The one HTML widget, visible, that says ``words``."""

        def found() -> list[Widget]:
            return [
                widget
                for widget in list(self.client.widgets.values())
                if words in html.unescape(str(widget.props.get("content", "")))
                and widget.props["visible"]
            ]

        self.client.wait_until(lambda: bool(found()))
        (widget,) = found()
        return widget

    def until(self, condition: Callable[[], bool]) -> None:
        self.client.wait_until(condition)

    def command(self) -> list[str]:
        """The words of the command that is shown."""
        content = self.html("scanloom fuse").props["content"]
        field = re.search(r"<textarea readonly[^>]*>(.*)</textarea>", content, re.DOTALL)
        assert field is not None
        return shlex.split(html.unescape(field[1]))

    def button(self, label: str) -> Widget:
        return self.client.find(label)

    @property
    def picture(self) -> Widget:
        # The first: those of the other mode come after it.
        return next(w for w in self.client.widgets.values() if w.type == "GuiImageMessage")


@pytest.fixture
def bench(small_scene: Path, tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(small_scene, tmp_path / "<b>root & more")
    yield bench
    bench.close()


class Held:
    """Stands for a long piece of work: reports, waits to be let on, and reports again."""

    def __init__(self) -> None:
        self.begun, self.go_on = threading.Event(), threading.Event()
        self.calls = 0
        self.cancelled = 0

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        self.calls += 1
        progress = next(arg for arg in args if callable(arg))
        progress(3, 12, "fusing")
        self.begun.set()
        assert self.go_on.wait(ENOUGH_S)
        try:
            progress(4, 12, "fusing")
        except Cancelled:
            self.cancelled += 1
            raise
        raise ExportError("no space is left.", file="disk", advice="Free space.")


def test_build_show_and_export(bench: Bench) -> None:
    results = bench.root / "small_room" / "results"
    assert bench.command()[-1] == str(results)
    bench.client.set_value("Figures", False)
    bench.until(lambda: "--no-figures" in bench.command())
    assert bench.floor == []
    assert not bench.picture.props["visible"]

    bench.client.click("Build")
    bench.html("frames     ")
    bench.until(lambda: bench.picture.props["visible"])
    assert bench.panel._built is not None
    grids = bench.panel._built.summary.grids
    assert set(grids) == {"lidar", "camera", "fused"}
    assert bench.floor == [grids["fused"]]
    assert (results / "map_fused.pgm").exists()

    # Other settings: the maps stay, and it is said that they are of others.
    bench.session.change_setting("noise", "epsilon", 2.25)
    bench.html("changed since this build")
    bench.until(lambda: bench.command()[4].startswith(str(bench.root / "small_room-2")))
    settings = f"--settings={bench.root / 'small_room-2' / 'settings.toml'}"
    assert settings in bench.command()
    bench.session.undo()
    bench.until(lambda: bench.command()[4] == str(results))

    # Clouds go beside the results.
    bench.client.click("Export clouds (PLY, PCD)")
    bench.html("Clouds: lidar ")
    assert (bench.root / "small_room" / "clouds" / "depth.pcd").exists()


def test_cancel_and_build_again(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    held = Held()
    monkeypatch.setattr(map_panel, "build", held)
    bench.client.click("Build")
    assert held.begun.wait(ENOUGH_S)
    bench.html("Fusing, 3 of 12")
    bench.until(lambda: bench.button("Build").props["disabled"])
    # What a browser sends all the same begins no second build.
    bench.panel._begin_build()
    bench.client.click("Cancel")
    bench.html("Stopping at the next step")
    held.go_on.set()
    bench.html("Cancelled; nothing was saved.")
    bench.until(lambda: not bench.button("Build").props["disabled"])
    assert not bench.button("Cancel").props["visible"]

    # A failure is told and stays in sight, and the panel goes on.
    assert (held.calls, held.cancelled) == (1, 1)
    bench.client.click("Build")
    bench.html("Failed: disk: no space is left. Free space.")
    told = bench.client.wait_for(
        lambda received: received.type == "NotificationShowMessage", ENOUGH_S
    )
    assert told.message["props"]["title"] == "disk: no space is left."
    bench.until(lambda: not bench.button("Build").props["disabled"])


def test_closing_cancels(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    held = Held()
    monkeypatch.setattr(map_panel, "build", held)
    bench.client.click("Build")
    assert held.begun.wait(ENOUGH_S)
    with bench.panel._lock:
        job = bench.panel._job._job
    assert job is not None
    closing = threading.Thread(target=bench.panel.close)
    closing.start()
    assert job._stop.wait(ENOUGH_S)
    held.go_on.set()
    closing.join(ENOUGH_S)
    assert (held.calls, held.cancelled) == (1, 1)
    bench.panel._begin_build()
    assert not bench.panel._job.is_running, "who has gone begins nothing"


def test_without_poses_it_says_why_there_are_no_maps(bench: Bench) -> None:
    bench.client.set_value("Figures", False)
    bench.session.change(virtual_row=60)
    bench.until(lambda: "--virtual-lidar=60" in bench.command())
    bench.client.click("Build")
    bench.html("No maps. A virtual LiDAR is cut from the camera's own images")
    bench.until(lambda: bench.button("Download .zip").props["visible"])
    assert not bench.picture.props["visible"]
    assert not bench.button("Export clouds (PLY, PCD)").props["visible"]
    assert bench.floor == []
    assert (bench.root / "small_room" / "results" / "frames.csv").exists()


def test_words_of_files_are_no_markup(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*args: Any, **kwargs: Any) -> Any:
        raise ExportError("<img src=x onerror=alert(1)>", file="</textarea><b>")

    monkeypatch.setattr(map_panel, "build", fail)
    bench.client.click("Build")
    content = bench.html("Failed: ").props["content"]
    assert "<img" not in content
    assert "<b>" not in content
    assert "<b>" not in bench.html("scanloom fuse").props["content"]
    assert bench.command()[-1] == str(bench.root / "small_room" / "results")
