"""What pass 1 tells people about its result."""

from dataclasses import replace

import numpy as np
import pytest

from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.fuse.align import RecordingAlignment, align_recording
from fusion_core.workflows.fuse.session import FuseOptions, open_session
from fusion_core.workflows.fuse.settings import PRESETS


@pytest.fixture(scope="module")
def alignment(scenes) -> RecordingAlignment:
    with open_recording(scenes("bedroom", duration_s=1.0)) as recording:
        found = align_recording(open_session(recording, FuseOptions(), PRESETS["default"]))
    assert found.estimate is not None
    assert found.along_curve
    return replace(
        found,
        peaks={**found.peaks, found.metric: found.peak},
        estimate=replace(found.estimate, refusal="", yaw_per_delay_rad_s=0.0),
    )


def test_rows_and_mount_that_agree_say_nothing(alignment):
    assert alignment.notes == ()


def test_an_offset_that_the_rows_do_not_favour_is_said_to_come_from_the_mount(alignment):
    rows = replace(alignment.peak, u=alignment.peak.u + 16.1, score=0.9)
    (note,) = replace(alignment, peaks={alignment.metric: rows}).notes
    assert f"u = {alignment.peak.u:.1f} comes from the mount" in note
    assert f"u = {rows.u:.1f} (score 0.900" in note


def test_a_yaw_that_depends_on_the_clock_says_so(alignment):
    estimate = replace(alignment.estimate, yaw_per_delay_rad_s=-0.4)
    (note,) = replace(alignment, estimate=estimate).notes
    assert "10 ms between the clocks would turn it by 0.23 deg" in note
    without_yaw = replace(estimate.mount, sd=(None,) * 6)
    unknown = replace(estimate, mount=without_yaw)
    assert replace(alignment, estimate=unknown).notes == ()
    # Less than the shown digits is nothing.
    slow = replace(estimate, yaw_per_delay_rad_s=float(np.deg2rad(0.4)))
    assert replace(alignment, estimate=slow).notes == ()
