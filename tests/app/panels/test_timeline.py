"""The timeline on a real server: buttons, keys, the strip under the pointer, and playback."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from scanloom.client_session import ClientSession
from scanloom.panels.timeline import TimelinePanel
from scanloom.server.workbench import ServeOptions, Workbench
from scanloom.state.frame_survey import FrameCounts, FrameStatus
from tests.app.viser_client import ViserClient, connect
from tests.patience import ENOUGH_S


class Visit:
    """A browser that sees the timeline, once the frames are counted."""

    def __init__(self, workbench: Workbench, client: ViserClient) -> None:
        self.client = client
        client.find("page events")
        client.wait_until(lambda: bool(workbench.sessions))
        (self.session,) = workbench.sessions
        self.panel = next(p for p in self.session.panels if isinstance(p, TimelinePanel))

    def until_aligned(self) -> None:
        self.client.wait_until(lambda: self.panel._counts is not None)

    @property
    def counts(self) -> FrameCounts:
        assert self.panel._counts is not None
        return self.panel._counts

    def html(self, sign: str) -> str:
        return next(
            (
                str(widget.props["content"])
                for widget in list(self.client.widgets.values())
                if sign in str(widget.props.get("content"))
            ),
            "",
        )

    def says(self, text: str) -> bool:
        return text in self.html('class="scanloom-frame"')

    def until_says(self, text: str) -> None:
        self.client.wait_until(lambda: self.says(text))

    def at(self, frame_index: int) -> bool:
        return self.session.view.frame_index == frame_index and self.session.wait(ENOUGH_S)

    def until_at(self, frame_index: int) -> None:
        self.client.wait_until(lambda: self.at(frame_index))

    def button(self, value: str) -> str:
        found = re.search(
            rf"<button[^>]*data-value=\"{value}\"[^>]*>", self.html('class="scanloom-timeline"')
        )
        assert found is not None, value
        return found.group()

    def picture(self) -> dict[str, str]:
        """The attributes of the strip's name."""
        return dict(re.findall(r'data-(\w+)="([^"]*)"', self.html('<div data-picture="time"')))


@pytest.fixture(scope="module")
def workbench(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workbench]:
    options = ServeOptions(
        recordings=[small_scene], port=0, output_root=tmp_path_factory.mktemp("out")
    )
    with Workbench(options) as serving:
        yield serving


@pytest.fixture(scope="module")
def resident(workbench: Workbench) -> Iterator[Visit]:
    with connect(workbench.address, storage={}) as client:
        visit = Visit(workbench, client)
        visit.until_aligned()
        client.wait_until(lambda: visit.counts.is_complete)
        yield visit


@pytest.fixture
def visit(resident: Visit) -> Visit:
    if resident.panel._playback.is_playing:
        resident.panel.play_or_pause()
    resident.session.change(frame_index=0, playback_speed=1.0, loop_playback=True)
    assert resident.session.wait(ENOUGH_S)
    return resident


def counts_of(session: ClientSession, conflicts: dict[int, int], noise: int = 5) -> FrameCounts:
    frames = len(session.frame_view.open_recording.frames)  # type: ignore[union-attr]  # it is shown
    counts = np.zeros((frames, 4), np.float32)
    counts[:, 0] = 100
    counts[:, 1] = noise
    for index, pairs in conflicts.items():
        counts[index, 3] = pairs
    status = np.full(frames, FrameStatus.COUNTED)
    return FrameCounts(counts=counts, status=status, done=frames, total=frames)


def test_frames_count_from_one_in_text_and_number_box(visit: Visit) -> None:
    visit.session.change(frame_index=4)
    visit.until_says("Frame 5 of 30")
    assert visit.client.find("Frame").value == 5
    assert visit.client.find("Frame").props["max"] == 30
    visit.client.set_value("Frame", 1)
    visit.until_at(0)


def test_the_buttons_go_through_the_frames(visit: Visit) -> None:
    for value, index in (
        ("next", 1),
        ("next", 2),
        ("previous", 1),
        ("last", 29),
        ("next", 0),
        ("first", 0),
    ):
        visit.client.press("timeline", value)
        visit.until_at(index)


def test_worst_frame_and_conflicts_are_where_the_counts_have_them(
    visit: Visit, monkeypatch: pytest.MonkeyPatch
) -> None:
    counts = counts_of(visit.session, {3: 9, 4: 4, 12: 40})
    monkeypatch.setattr(visit.panel, "_counts", counts)
    monkeypatch.setattr(visit.panel, "_draw", lambda: None)
    for action, index in (
        ("next_conflict", 3),
        ("next_conflict", 12),
        ("next_conflict", 3),
        ("previous_conflict", 12),
        ("first", 0),
        ("worst", 12),
    ):
        visit.client.press("timeline", action)
        visit.until_at(index)
    for key, index in (
        ("First frame", 0),
        ("Next conflict (in the review: no)", 3),
        ("Previous conflict", 12),
        ("First frame", 0),
        ("Frame with the most noise", 12),
    ):
        visit.client.trigger(key)
        visit.until_at(index)


def test_a_button_without_a_frame_to_go_to_says_why(visit: Visit) -> None:
    panel = visit.panel
    own, survey = visit.counts, panel._survey

    class Counted:
        counts = counts_of(visit.session, {}, noise=0)

    panel._survey = Counted()  # type: ignore[assignment]  # as far as it is needed
    panel._redraw()
    visit.client.wait_until(lambda: " disabled" in visit.button("worst"))
    assert "No noise" in visit.button("worst")
    assert "No frame of this recording has a conflict" in visit.button("next_conflict")
    Counted.counts = FrameCounts(
        counts=np.full((30, 4), np.nan, np.float32),
        status=np.full(30, FrameStatus.UNKNOWN),
        done=0,
        total=30,
    )
    panel._redraw()
    visit.client.wait_until(lambda: "counted yet" in visit.button("worst"))
    visit.until_says("counting noise: 0 of 30 frames")
    panel._survey = survey
    panel._redraw()
    visit.client.wait_until(lambda: " disabled" not in visit.button("worst"))
    assert visit.counts is own


def test_a_key_without_a_frame_to_go_to_says_why(
    visit: Visit, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(visit.panel, "_counts", None)
    visit.client.drain()
    visit.client.trigger("Next conflict (in the review: no)")
    note = visit.client.wait_for(
        lambda received: received.type == "NotificationShowMessage", ENOUGH_S
    ).message
    assert note["props"]["body"] == "No frame is counted yet."


def test_a_click_on_the_strip_goes_to_the_frame_there(visit: Visit) -> None:
    strip = visit.panel._strip
    assert strip is not None
    for index in (17, 3):
        place = strip.place_of(index)
        assert place is not None
        visit.client.point("time", "click", *place)
        visit.until_at(index)
    # Beside the frames nothing happens.
    visit.client.point("time", "click", 2.0, 2.0)
    visit.client.press("timeline", "next")
    visit.until_at(4)


def test_a_drag_goes_through_the_frames_and_beyond_the_end_to_the_last(visit: Visit) -> None:
    strip = visit.panel._strip
    assert strip is not None
    for index in (2, 9):
        place = strip.place_of(index)
        assert place is not None
        visit.client.point("time", "drag", place[0], -40.0)
        visit.until_at(index)
    visit.client.point("time", "drag", 5000.0, 10.0)
    visit.until_at(29)
    visit.client.point("time", "drag", -10.0, 10.0)
    visit.until_at(0)


def test_the_pointer_on_the_strip_reads_out_the_frame_and_sends_no_picture(visit: Visit) -> None:
    strip = visit.panel._strip
    assert strip is not None
    place, elsewhere = strip.place_of(6), strip.place_of(2)
    assert place is not None
    assert elsewhere is not None
    # What answers this pointer comes after the pictures of the frame that was set up.
    visit.client.point("time", "move", *elsewhere)
    visit.client.wait_until(lambda: "frame 3 of 30" in visit.picture()["readout"])
    visit.client.drain()
    visit.client.point("time", "move", *place)
    visit.client.wait_until(lambda: "frame 7 of 30" in visit.picture()["readout"])
    pairs = visit.counts.counts[6].astype(int)
    for count, name in zip(pairs[1:], ("hole", "burr", "conflict"), strict=True):
        assert (f"{count} {name}" in visit.picture()["readout"]) == (count > 0)
    marks = json.loads(visit.picture()["marks"].replace("&quot;", '"'))
    assert [mark["kind"] for mark in marks] == ["column", "cross"]
    assert marks[1]["x_px"] == pytest.approx(place[0], abs=0.1)
    assert not any(
        "_data" in received.message.get("updates", {}) for received in visit.client.drain()
    )
    visit.client.point("time", "leave", 0.0, 0.0)
    visit.client.wait_until(lambda: visit.picture()["readout"] == "")


def test_the_cursor_moves_without_a_new_picture(visit: Visit) -> None:
    strip = visit.panel._strip
    visit.session.change(frame_index=11)
    assert visit.session.wait(ENOUGH_S)
    assert visit.panel._strip is strip
    marks = json.loads(
        visit.panel._picture._about_html()
        .split('data-marks="')[1]
        .split('"')[0]
        .replace("&quot;", '"')
    )
    assert marks[0]["kind"] == "column"
    assert strip is not None
    assert marks[0]["x_px"] == pytest.approx(strip.place_of(11)[0], abs=0.1)  # type: ignore[index]  # it exists
    # The legend is above the box.
    above_px = strip.box.top - (marks[0]["y_px"] - marks[0]["reach_px"])
    assert 0.0 <= above_px < 4.0


def test_play_says_pause_and_stops_again(visit: Visit) -> None:
    visit.client.press("timeline", "play")
    visit.client.wait_until(lambda: "Pause" in visit.button("play"))
    visit.client.wait_until(lambda: visit.session.view.frame_index > 2)
    visit.client.trigger("Play or pause")
    visit.client.wait_until(lambda: "Play" in visit.button("play"))
    assert not visit.panel._playback.is_playing


def test_play_at_the_end_begins_at_the_first_frame(visit: Visit) -> None:
    visit.session.change(frame_index=29, loop_playback=False)
    assert visit.session.wait(ENOUGH_S)
    visit.client.press("timeline", "play")
    visit.client.wait_until(lambda: 0 < visit.session.view.frame_index < 29)
    visit.client.wait_until(lambda: not visit.panel._playback.is_playing)
    assert visit.session.view.frame_index == 29


def test_the_speed_is_chosen_and_marked(visit: Visit) -> None:
    visit.client.press("timeline", "speed 4")
    visit.client.wait_until(lambda: visit.session.view.playback_speed == 4.0)
    visit.client.wait_until(lambda: 'aria-pressed="true"' in visit.button("speed 4"))
    assert 'aria-pressed="false"' in visit.button("speed 1")


def test_what_no_button_sends_is_ignored(visit: Visit) -> None:
    visit.client.press("timeline", "__class__")
    visit.client.press("timeline", "next")
    visit.until_at(1)


def test_the_strip_is_as_wide_as_its_panel(visit: Visit) -> None:
    visit.panel.set_width(500.0)
    visit.client.wait_until(lambda: visit.picture()["width"] == "500")
    visit.panel.set_width(1.0)
    visit.client.wait_until(lambda: visit.picture()["width"] == "240")
    visit.panel.set_width(736.0)


def test_whoever_leaves_wants_no_survey(workbench: Workbench, resident: Visit) -> None:
    opened = resident.session.frame_view.open_recording  # type: ignore[union-attr]  # it is shown
    with connect(workbench.address, storage={}) as client:
        client.wait_until(lambda: len(opened.surveys._wishes) == 2)
    resident.client.wait_until(lambda: len(opened.surveys._wishes) == 1)
