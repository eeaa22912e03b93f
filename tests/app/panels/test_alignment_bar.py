"""The bar above all steps, without a browser."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fusion_core.model.errors import AlignmentFailed
from scanloom.frame_view import FrameView, alignment_progress_text, compute_frame_view
from scanloom.panels.alignment_bar import AlignmentBar
from scanloom.state.library import Library
from scanloom.state.open_recording import AlignmentProgress, OpenRecording
from scanloom.state.view import View


@pytest.fixture
def open_recording(small_scene: Path) -> Iterator[OpenRecording]:
    library = Library([small_scene], [])
    yield library.open(View(recording=small_scene.name))
    library.close()


@pytest.fixture
def frame_view(open_recording: OpenRecording, small_scene: Path) -> FrameView:
    return compute_frame_view(View(recording=small_scene.name), open_recording)


def bar_of(frame_view: FrameView) -> str:
    gui: Any = SimpleNamespace(add_html=lambda content: SimpleNamespace(content=content))
    bar = AlignmentBar(gui)
    bar.show_progress(frame_view)
    return str(bar._bar.content)


@pytest.mark.parametrize(
    ("step", "text", "percent"),
    [
        (AlignmentProgress(done=0, total=None, what="waiting"), "waiting. The first time ", 0),
        (AlignmentProgress(done=40, total=80, what="searching"), "searching, 40 of 80 images.", 50),
        (
            AlignmentProgress(done=40, total=80, what="searching", remaining_s=12.2),
            "searching, 40 of 80 images. About 10 s left.",
            50,
        ),
        (
            AlignmentProgress(done=79, total=80, what="searching", remaining_s=0.2),
            "searching, 79 of 80 images. A few seconds left.",
            99,
        ),
        (
            AlignmentProgress(done=1, total=900, what="searching", remaining_s=200.0),
            "searching, 1 of 900 images. About 3 min left.",
            0,
        ),
    ],
)
def test_it_says_what_is_done_how_far_and_how_long_still(
    frame_view: FrameView, step: AlignmentProgress, text: str, percent: int
) -> None:
    frame_view.open_recording.progress = step
    assert text in alignment_progress_text(frame_view.open_recording)
    content = bar_of(frame_view)
    assert text in content
    assert f"aria-valuenow='{percent}'" in content
    assert "data-alignment='running'" in content


def test_it_says_what_the_picture_is_worth(frame_view: FrameView) -> None:
    assert frame_view.raw is not None
    for is_recorded, text in ((True, "the mount that the recording names"), (False, "not known")):
        raw = replace(frame_view.raw, is_mount_recorded=is_recorded)
        assert text in bar_of(replace(frame_view, raw=raw))


def test_a_failure_stays_and_is_text(frame_view: FrameView) -> None:
    failure = AlignmentFailed("no <b>peak</b>.", advice="Go on.")
    frame_view.open_recording.failure = failure
    content = bar_of(replace(frame_view, failure=failure))
    assert "data-alignment='failed'" in content
    assert "no &lt;b&gt;peak&lt;/b&gt;." in content


def test_without_an_estimate_none_is_given(open_recording: OpenRecording) -> None:
    for done in range(1, 4):
        open_recording._advance(done, 10, "searching")
        assert open_recording.progress.remaining_s is None
    # As if the first image had been two seconds ago.
    time_left = open_recording._time_left
    assert time_left._since_s is not None
    time_left._since_s -= 2.0
    open_recording._advance(5, 10, "searching")
    remaining_s = open_recording.progress.remaining_s
    assert remaining_s == pytest.approx(2.0 * 5 / 4, rel=0.2)
    open_recording._advance(0, None, "refining the mount")
    assert open_recording.progress.remaining_s is None
    assert re.search("refining the mount", alignment_progress_text(open_recording))
