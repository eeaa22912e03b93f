"""The Match panel of frames that have no match: nothing of another frame is left to be seen."""

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import viser

from fusion_core.model.errors import AlignmentFailed, RecordingError
from fusion_core.workflows.fuse.frame_match import curves_at
from scanloom.frame_view import FrameView, compute_frame_view
from scanloom.panels.match import MatchPanel
from scanloom.state.library import Library
from scanloom.state.open_recording import OpenRecording
from scanloom.state.view import View
from tests.patience import ENOUGH_S


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


@pytest.fixture(scope="module")
def open_recording(small_scene: Path) -> Iterator[OpenRecording]:
    library = Library([small_scene], [])
    found = library.open(View(recording=small_scene.name))
    found.align(lambda: None)
    assert found.wait(ENOUGH_S)
    yield found
    library.close()


@pytest.fixture
def view() -> View:
    return View(recording="a room", panel="Match", frame_index=4)


@pytest.fixture
def panel(server: viser.ViserServer, view: View) -> MatchPanel:
    return MatchPanel(server.gui, SimpleNamespace(view=view))  # type: ignore[arg-type]  # a session as far as it is needed


def seen(panel: MatchPanel) -> bool:
    return bool(panel._curves.visible)


def test_a_match_is_drawn(panel: MatchPanel, open_recording: OpenRecording, view: View) -> None:
    assert not seen(panel)
    panel.show(compute_frame_view(view, open_recording))
    assert seen(panel)
    assert "Best fit: **u = " in panel._summary.content
    sample, depth_m, lidar_m = panel._curves.data
    assert sample.tolist() == list(range(lidar_m.size))
    both = np.concatenate([depth_m, lidar_m])
    low_m, high_m = panel._curves.scales["y"]["range"]
    assert low_m <= np.nanmin(both) < np.nanmax(both) <= high_m
    frame_view = compute_frame_view(view, open_recording)
    assert frame_view.match is not None
    peak = frame_view.match.search.peaks[view.settings.search.metric]
    expected = curves_at(frame_view.match, (peak.u, peak.v), masked=view.settings.search.mask_holes)
    np.testing.assert_array_equal(lidar_m, expected[0])
    np.testing.assert_array_equal(depth_m, expected[1])


def test_while_it_is_being_aligned_it_says_where_to_look(
    panel: MatchPanel, open_recording: OpenRecording, view: View
) -> None:
    panel.show(FrameView(view=view, open_recording=open_recording))
    assert "still being aligned" in panel._summary.content


@pytest.mark.parametrize(
    ("failure", "words"),
    [
        (AlignmentFailed("no peak.", advice="Go on."), r"no peak\. Go on\."),
        (RecordingError("is <b>cut</b>.", file="a.mcap"), r"a\.mcap\: is \<b\>cut\<\/b\>\. "),
    ],
)
def test_without_a_match_it_says_why_and_shows_no_other(
    panel: MatchPanel,
    open_recording: OpenRecording,
    view: View,
    failure: Any,
    words: str,
) -> None:
    panel.show(compute_frame_view(view, open_recording))
    panel.show(FrameView(view=view, open_recording=open_recording, failure=failure))
    assert not seen(panel)
    assert panel._summary.content == words.strip()
    panel.show(compute_frame_view(view, open_recording))
    assert seen(panel)
