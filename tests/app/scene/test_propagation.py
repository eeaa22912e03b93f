"""Labels for the same place, from a LiDAR that has turned and moved."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.classes import NoiseClass
from fusion_core.model.geometry import invert_transform, transform_from_planar, transform_points
from fusion_core.model.labels import Capture, Label
from scanloom.scene.propagation import labels_at_place, moved_azimuths
from scanloom.state.frame_runs import FrameRuns

BEAMS_RAD = np.deg2rad(np.arange(-90.0, 91.0))
SCAN = Capture("lidar", "/scan", 7, 0, 1, BEAMS_RAD.size)
IMAGE = Capture("depth", "/depth", 7, 0, 4, 4)

angles = st.floats(-1.0, 1.0)


@given(angles, st.floats(0.5, 8.0), st.tuples(angles, angles, angles))
def test_a_point_is_seen_where_the_transform_puts_it(
    azimuth_rad: float, range_m: float, pose: tuple[float, float, float]
) -> None:
    point = range_m * np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0])
    T_here_there = transform_from_planar(np.array(pose))
    seen = transform_points(invert_transform(T_here_there), point[np.newaxis])[0]
    if np.hypot(seen[0], seen[1]) < 0.1:
        return
    found = moved_azimuths(np.array([azimuth_rad]), np.array([range_m]), np.array(pose))[0]
    np.testing.assert_allclose(np.exp(1j * found), (seen[0] + 1j * seen[1]) / np.hypot(*seen[:2]))


def test_what_has_no_range_turns_but_does_not_shift() -> None:
    seen = moved_azimuths(np.array([0.3]), np.array([np.nan]), np.array([5.0, -2.0, 0.1]))
    np.testing.assert_allclose(seen, [0.2])


def runs_of(codes: list[int]) -> FrameRuns:
    """A scan with one class for each beam."""
    code = np.array(codes)
    start = np.concatenate([[0], np.flatnonzero(np.diff(code)) + 1])
    beams = np.arange(code.size, dtype=np.int32)
    return FrameRuns(
        scan=SCAN,
        image=IMAGE,
        sensor=np.zeros(start.size, dtype=np.int64),
        noise_class=code[start],
        confidence=np.ones(start.size),
        start=np.append(start, code.size).astype(np.int32),
        row=np.zeros(code.size, dtype=np.int32),
        column=beams,
        beam=beams.copy(),
    )


def test_only_samples_of_the_class_in_these_directions_are_labelled() -> None:
    codes = [0] * BEAMS_RAD.size
    codes[80:100] = [int(NoiseClass.BURR)] * 20
    directions_rad = BEAMS_RAD[75:91]
    kind = 0, int(NoiseClass.BURR)
    labels = labels_at_place(runs_of(codes), kind, BEAMS_RAD, directions_rad, Label.GOOD)
    assert labels is not None
    assert labels.capture == SCAN
    assert labels.column.tolist() == list(range(80, 91))
    assert set(labels.label.tolist()) == {Label.GOOD}
    kind = 0, int(NoiseClass.HOLE)
    assert labels_at_place(runs_of(codes), kind, BEAMS_RAD, directions_rad, Label.GOOD) is None
