"""What is displayed before a recording is aligned."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fusion_core.workflows.fuse.settings import PRESETS
from scanloom.frame_view import compute_frame_view
from scanloom.state.library import Library
from scanloom.state.open_recording import OpenRecording
from scanloom.state.view import View

RAW_VIEW = """
import sys
from pathlib import Path

import scanloom.server.workbench
from scanloom.frame_view import compute_frame_view
from scanloom.plots.depth_image import depth_picture
from scanloom.scene.frame_geometry import UnmatchedFrame, unmatched_geometry
from scanloom.state.library import Library
from scanloom.state.view import View

path = Path(sys.argv[1])
view = View(recording=path.name)
raw = compute_frame_view(view, Library([path], []).open(view)).raw
assert raw is not None and raw.scan is not None
heavy = {"numba", "scipy", "pyarrow", "gtsam", "matplotlib.pyplot", "open3d"}
print(sorted(heavy & sys.modules.keys()))
"""


@pytest.fixture
def open_recording(small_scene: Path) -> Iterator[OpenRecording]:
    library = Library([small_scene], [])
    yield library.open(View(recording=small_scene.name))
    library.close()


def test_a_raw_view_has_depth_colour_and_scan(
    open_recording: OpenRecording, small_scene: Path
) -> None:
    for number in (0, 7, 10_000):
        shown = compute_frame_view(
            View(recording=small_scene.name, frame_index=number), open_recording
        )
        index = min(number, len(open_recording.frames) - 1)
        assert shown.view.frame_index == index
        assert shown.chain is None
        assert shown.is_being_aligned
        assert shown.raw is not None
        assert shown.raw.stamp_ns == open_recording.frames.image(index).stamp_ns
        assert shown.raw.depth_m.shape == open_recording.fuse_session.rig.views[0].stored_shape
        assert not shown.raw.depth_m.flags.writeable
        assert shown.raw.scan is not None
        assert shown.paired is shown.raw.paired
        assert shown.color is not None


def test_the_mount_is_the_recordings_or_said_to_be_a_guess(open_recording: OpenRecording) -> None:
    raw = open_recording.raw(0)
    recorded = open_recording.fuse_session.rig.recorded_mount
    assert raw.is_mount_recorded == (recorded is not None)
    if recorded is None:
        assert not np.any(raw.mount.vector())
    else:
        assert raw.mount == recorded


def test_a_view_that_shows_another_frame_differs_in_more_than_progress(
    open_recording: OpenRecording, small_scene: Path
) -> None:
    view = View(recording=small_scene.name)
    first = compute_frame_view(view, open_recording)
    assert not first.differs_in_progress_only(None)
    assert compute_frame_view(view, open_recording).differs_in_progress_only(first)
    next_frame = compute_frame_view(view.changed(frame_index=1), open_recording)
    assert not next_frame.differs_in_progress_only(first)
    other_setting = view.changed(settings=PRESETS["published"])
    assert not compute_frame_view(other_setting, open_recording).differs_in_progress_only(first)


def test_a_raw_view_needs_no_compiled_code_and_no_heavy_library(small_scene: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", RAW_VIEW, str(small_scene)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.stderr == ""
    assert done.stdout == "[]\n"
