"""The Recording panel on a real server, worked by a browser's messages."""

import html
import re
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import viser

from fusion_core.simulation.scenes import SceneSettings, find_scene, write_scene
from fusion_core.workflows.stream_gaps import StreamGaps
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.panels.depth_cameras import distinct_labels
from scanloom.panels.recording import RecordingPanel
from scanloom.panels.stream_table import stream_table
from scanloom.scene.verdict import verdict_of
from scanloom.state.library import Library
from scanloom.state.view import View
from tests.app.viser_client import ViserClient, Widget, connect
from tests.patience import ENOUGH_S


class Bench:
    """A server whose one browser has a session with the Recording panel alone."""

    def __init__(self, recordings: list[Path]) -> None:
        self.library = Library(recordings, [])
        self.first = View(recording=next(iter(self.library.named())))
        self.furnished = threading.Event()
        self.server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        self.server.on_client_connect(self._welcome)
        self.client: ViserClient = connect(f"http://127.0.0.1:{self.server.get_port()}")
        assert self.furnished.wait(ENOUGH_S)
        self.until(
            lambda: (
                self.session.frame_view is not None and self.session.frame_view.chain is not None
            )
        )

    def _welcome(self, client: viser.ClientHandle) -> None:
        self.session = ClientSession(client, self.library, self.first)
        self.panel = RecordingPanel(client.gui, self.session)
        self.session.panels = [self.panel]
        self.session.refresh()
        self.furnished.set()

    def close(self) -> None:
        self.session.close()
        self.client.close()
        self.server.stop()
        self.library.close()

    @property
    def frame_view(self) -> FrameView:
        assert self.session.frame_view is not None
        return self.session.frame_view

    def until(self, condition: Callable[[], bool]) -> None:
        """Wait for what some message brings about."""
        self.client.wait_until(condition)
        assert self.session.wait(ENOUGH_S)

    def change(self, **values: object) -> None:
        self.session.change(**values)
        assert self.session.wait(ENOUGH_S)

    def boxes(self) -> dict[str, bool]:
        """The check boxes by label."""
        return {
            w.label: w.value
            for w in self.client.widgets.values()
            if w.type == "GuiCheckboxMessage" and w.label != "Apply the clock offset"
        }

    def words(self, within: str) -> str:
        """The visible text that says these words."""

        def found() -> list[str]:
            return [text for text in self.texts() if within in text]

        self.client.wait_until(lambda: bool(found()))
        return found()[0]

    def texts(self) -> list[str]:
        """All visible text, of HTML and of Markdown."""
        frame_view = [w.props for w in self.client.widgets.values() if w.props.get("visible")]
        texts = [str(props.get("content", props.get("_markdown", ""))) for props in frame_view]
        return [html.unescape(text) for text in texts if text]

    def _plot(self) -> Widget:
        (plot,) = (w for w in self.client.widgets.values() if w.type == "GuiUplotMessage")
        return plot


@pytest.fixture(scope="module")
def four_cameras(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("panorama") / "four cameras.mcap"
    own = find_scene("robot_at_home").settings.model_dump()
    given = own | {"duration_s": 1.5, "image_scale": 0.25}
    write_scene("robot_at_home", path, settings=SceneSettings(**given))
    return path


@pytest.fixture(scope="module")
def module_bench(four_cameras: Path, small_scene: Path) -> Iterator[Bench]:
    bench = Bench([four_cameras, small_scene])
    yield bench
    bench.close()


@pytest.fixture
def bench(module_bench: Bench) -> Bench:
    """The bench as at the start, its recording aligned."""
    module_bench.change(**dict(module_bench.first))
    module_bench.until(lambda: module_bench.frame_view.chain is not None)
    return module_bench


def depth_topics(bench: Bench) -> list[str]:
    topics = bench.frame_view.open_recording.fuse_session.recording.topics
    return [topic.name for topic in topics if topic.role == "depth"]


def used(bench: Bench) -> tuple[str, ...]:
    """The depth topics of what is shown."""
    assert bench.session.wait(ENOUGH_S)
    return bench.frame_view.open_recording.fuse_session.streams.depth


# Several cameras


def test_every_depth_camera_has_a_box_and_all_are_found_by_type(bench: Bench) -> None:
    topics = depth_topics(bench)
    assert len(topics) == 4
    labels = ["/camera_1", "/camera_2", "/camera_3", "/camera_4"]
    assert topics == [f"{label}/depth/image_raw" for label in labels]
    bench.until(lambda: bench.boxes() == {"Found by type": True, **dict.fromkeys(labels, True)})


def test_any_cameras_can_be_chosen_and_the_type_takes_over_again(bench: Bench) -> None:
    topics = depth_topics(bench)
    bench.client.set_value("/camera_2", False)
    chosen = (topics[0], *topics[2:])
    bench.until(lambda: bench.session.view.depth_topics == chosen)
    assert used(bench) == chosen
    bench.until(lambda: not bench.boxes()["Found by type"])
    bench.client.set_value("/camera_4", False)
    bench.until(lambda: bench.session.view.depth_topics == (topics[0], topics[2]))
    bench.client.set_value("/camera_2", True)
    # In the recording's order, however they were chosen.
    bench.until(lambda: bench.session.view.depth_topics == tuple(topics[:3]))
    assert used(bench) == tuple(topics[:3])
    bench.client.set_value("Found by type", True)
    bench.until(lambda: bench.session.view.depth_topics == ())
    assert used(bench) == tuple(topics)
    bench.until(lambda: all(bench.boxes().values()))


def test_the_last_camera_cannot_be_taken_away(bench: Bench) -> None:
    topics = depth_topics(bench)
    bench.change(depth_topics=(topics[2],))
    bench.until(lambda: [label for label, on in bench.boxes().items() if on] == ["/camera_3"])
    bench.client.set_value("/camera_3", False)
    bench.until(lambda: bench.boxes()["/camera_3"])
    assert bench.session.view.depth_topics == (topics[2],)
    assert used(bench) == (topics[2],)


@pytest.mark.parametrize(
    ("topics", "labels"),
    [
        ([], []),
        (["/a/depth/image"], ["/a/depth/image"]),
        (["/a/depth/image", "/b/depth/image"], ["/a", "/b"]),
        (["/a/depth/image", "/a/depth/other"], ["/a/depth/image", "/a/depth/other"]),
        (["/depth", "/a/depth"], ["/depth", "/a/depth"]),
        (["/x/a/depth", "/a/depth"], ["/x/a", "/a"]),
        (["depth", "other"], ["depth", "other"]),
    ],
)
def test_a_label_is_what_tells_a_topic_from_the_others(
    topics: list[str], labels: list[str]
) -> None:
    assert distinct_labels(topics) == labels


def test_another_recording_has_boxes_of_its_own(bench: Bench, small_scene: Path) -> None:
    bench.session.show_recording(small_scene.name)
    expected = {"Found by type": True, "/camera/depth/image_raw": True}
    bench.until(lambda: bench.boxes() == expected)
    bench.session.show_recording(bench.first.recording)
    bench.until(lambda: len(bench.boxes()) == 5)


# Pairs in time


def test_the_plot_follows_frame_and_clock_offset_and_nothing_else(
    bench: Bench, small_scene: Path
) -> None:
    bench.change(recording=small_scene.name, frame_index=0)
    bench.until(lambda: bench.frame_view.fused is not None)
    plot = bench.panel._pairing._plot
    first = plot.data
    assert plot.visible
    assert "ms** apart at most" in bench.words("apart at most")
    bench.change(
        settings=bench.first.with_setting("noise", "epsilon", 4.0).settings, selected_beam=3
    )
    marked = bench.panel._pairing._marked
    bench.change(selected_beam=None)
    assert bench.panel._pairing._marked is marked
    assert plot.data is first
    bench.change(frame_index=9)
    bench.until(lambda: plot.data is not first)
    times_ns = bench.frame_view.open_recording.frames.times_ns
    for data, index in ((first, 0), (plot.data, 9)):
        at_s = (times_ns[index] - times_ns[0]) / 1e9
        assert data[0][np.isfinite(data[-1])].tolist() == [at_s, at_s]
    curves = bench.panel._pairing._curves
    assert curves is marked[0]
    bench.change(apply_clock_offset=True)
    chain = bench.frame_view.chain
    assert chain is not None
    assert bench.panel._pairing._curves is not curves
    said = f"The clock offset of {chain.alignment.mount.clock_offset_ms:.1f} ms is taken out."
    assert said.replace("-", "−") in bench.words("is taken out")


def test_a_closed_panel_draws_no_plot(bench: Bench) -> None:
    bench.change(panel="Map", frame_index=2)
    marked = bench.panel._pairing._marked
    bench.change(frame_index=3)
    assert bench.panel._pairing._marked is marked
    bench.change(panel="Recording")
    assert bench.panel._pairing._marked[1] == 3


def test_frames_without_a_scan_are_counted_as_text(bench: Bench, small_scene: Path) -> None:
    narrow = bench.first.with_setting("time", "max_gap_ms", 25.0).settings
    bench.change(recording=small_scene.name, settings=narrow, alignment_settings=narrow)
    said = bench.words("have no scan within 25 ms")
    found = re.search(r"\*\*(\d+)\*\* of (\d+) depth images", said)
    assert found is not None
    open_recording = bench.frame_view.open_recording
    without = sum(
        open_recording.frames.pair(n).window is None for n in range(len(open_recording.frames))
    )
    assert (int(found[1]), int(found[2])) == (without, len(open_recording.frames))
    assert 0 < without < len(open_recording.frames)


def test_how_scans_are_paired_is_chosen_and_shown(bench: Bench, small_scene: Path) -> None:
    bench.change(recording=small_scene.name)
    made = bench.first.with_setting("time", "pair_by", "interpolated").settings
    bench.change(settings=made, alignment_settings=made)
    bench.words("come from scans interpolated at the images' instants")
    match = bench.frame_view.match
    assert match is not None
    assert match.pair.aligned_scan.stamp_ns == match.stamp_ns
    counted = bench.first.with_setting("time", "pair_by", "rates").settings
    bench.change(settings=counted, alignment_settings=counted)
    bench.words("counted by the two rates")


def test_where_nothing_can_be_aligned_the_stamps_show_why(bench: Bench, small_scene: Path) -> None:
    none = bench.first.with_setting("time", "max_gap_ms", 0.001).settings
    bench.change(recording=small_scene.name, settings=none, alignment_settings=none)
    said = bench.words("have no scan within 0.001 ms")
    # The stamps are known before that.
    bench.until(lambda: bench.frame_view.failure is not None)
    assert bench.frame_view.chain is None
    count = len(bench.frame_view.open_recording.frames)
    assert f"**{count}** of {count} depth images" in said


def test_a_virtual_lidar_has_no_gaps(bench: Bench, small_scene: Path) -> None:
    bench.change(recording=small_scene.name, virtual_row=60)
    bench.words("has the stamps of its images")
    assert verdict_of(bench.frame_view).sentence.endswith(", row 60 as a virtual LiDAR")
    bench.until(lambda: not bench._plot().props["visible"])


def test_nothing_of_the_recording_before_is_reported_while_another_is_aligned(
    bench: Bench, small_scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.words("averaged in the recording's field")
    go_on = threading.Event()

    def wait(*_: object) -> None:
        assert go_on.wait(ENOUGH_S)
        raise ValueError("of this test")

    monkeypatch.setattr("scanloom.state.open_recording.align_recording", wait)
    bench.change(
        recording=small_scene.name,
        alignment_settings=bench.first.with_setting("search", "min_overlap", 0.55).settings,
    )
    assert bench.frame_view.is_being_aligned
    bench.until(
        lambda: (
            not any(
                words in text
                for text in bench.texts()
                for words in ("averaged in the recording's field", "of the same instant")
            )
        )
    )
    go_on.set()
    bench.until(
        lambda: (
            bench.session.frame_view is not None
            and bench.session.frame_view.open_recording.failure is not None
        )
    )


# The table


def described(**gaps: StreamGaps) -> str:
    topics = [
        {"name": f"/{name}", "role": "camera_info", "count": 4, "rate_hz": None, "type": "x"}
        for name in ("a", "b")
    ]
    document = {
        "format": "ROS <2>",
        "duration_s": 6.0,
        "topics": topics,
        "can": ["It can be <fused>."],
        "warnings": ["/b is <broken>."],
    }
    return stream_table(document, {f"/{name}": found for name, found in gaps.items()})


def test_a_gap_stands_below_its_stream() -> None:
    table = described(a=StreamGaps(count=0), b=StreamGaps(count=2, longest_s=1.2, longest_at_s=3.5))
    rows = re.findall(r"<tr>(.*?)</tr>", table)
    assert "2 gaps, the longest 1.20 s from 3.50 s on" in rows[3]
    assert len(rows) == 4
    assert "A gap is more than 3 times" in table
    one = described(a=StreamGaps(count=1, longest_s=1.0, longest_at_s=0.0))
    assert "1 gap: 1.00 s from 0.00 s on" in one


def test_a_table_without_gaps_says_so_and_one_without_times_says_nothing() -> None:
    assert "No stream has a gap" in described(a=StreamGaps(count=0))
    assert "gap" not in described()


def test_what_a_recording_says_is_text() -> None:
    table = described()
    assert "ROS &lt;2&gt;, 6 s" in table
    assert "It can be &lt;fused&gt;." in table
    assert table.index("<b>Warning:</b> /b is &lt;broken&gt;.") < table.index("<table")
