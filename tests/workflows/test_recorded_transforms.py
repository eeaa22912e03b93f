"""The transforms of a recording: frames by their names, and the root that static ones lead to."""

import numpy as np
import pytest

from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.recorded_transforms import RecordedTransforms, frame_name


def transforms_of(log):
    recording = log.open()
    return RecordedTransforms(recording, choose_streams(recording).tf_static)


@pytest.mark.parametrize("written", ["laser", "/laser"])
def test_a_leading_slash_names_the_same_frame(written):
    assert frame_name(written) == "laser"


def test_the_root_is_where_static_parents_end(log, pose_of):
    log.scan(0.0)
    log.transform("/base_footprint", "/base", pose_of(z=0.1))
    log.transform("base", "laser", pose_of(0.2))
    log.transform("odom", "base_footprint", pose_of(5.0), at_ms=0.0)
    transforms = transforms_of(log)
    assert transforms.root_of("laser") == "base_footprint"
    assert transforms.root_of("nowhere") == "nowhere"
    T_root_laser = transforms.tree.lookup("base_footprint", "laser", 0)
    np.testing.assert_allclose(T_root_laser[:3, 3], [0.2, 0.0, 0.1])
    assert "odom" not in transforms.tree.frames
    transforms.add_timed("/tf")
    assert "odom" in transforms.tree.frames


def test_a_cycle_of_parents_ends(log, pose_of):
    log.scan(0.0)
    log.transform("a", "b", pose_of())
    log.transform("b", "a", pose_of())
    assert transforms_of(log).root_of("a") in ("a", "b")
