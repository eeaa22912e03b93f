"""Which beam a click means."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from scanloom.scene.picking import nearest_beam

metres = st.floats(-5.0, 5.0)


@given(st.integers(0, 40), st.tuples(metres, metres, st.floats(1.0, 8.0)), st.floats(0.1, 9.0))
def test_a_ray_to_a_beam_means_that_beam(beam, eye, length):
    beams_m = np.zeros((41, 3), dtype=np.float32)
    beams_m[:, 0], beams_m[:, 1] = 3.0, np.linspace(-2.0, 2.0, 41)
    direction = length * (beams_m[beam] - np.array(eye))
    assert nearest_beam(beams_m, np.array(eye), direction) == beam


def test_beams_without_a_point_or_far_from_the_ray_are_not_meant():
    beams_m = np.array([[np.nan] * 3, [3.0, 0.0, 0.0], [3.0, 1.0, 0.0]], dtype=np.float32)
    eye = np.array([0.0, 0.0, 0.0])
    assert nearest_beam(beams_m, eye, np.array([1.0, 0.01, 0.0])) == 1
    assert nearest_beam(beams_m, eye, np.array([1.0, 0.1, 0.0])) is None
    assert nearest_beam(beams_m, eye, np.array([-1.0, 0.0, 0.0])) is None
    assert nearest_beam(beams_m[:1], eye, np.array([1.0, 0.0, 0.0])) is None
    assert nearest_beam(beams_m[:0], eye, np.array([1.0, 0.0, 0.0])) is None
