"""A pose that is turned to the up that its camera sees."""

import numpy as np
from hypothesis import given
from scipy.spatial.transform import Rotation

from fusion_core.calibration.planar.level_start import turn_level
from fusion_core.model.geometry import invert_transform, make_transform
from tests.patches.test_up_direction import random_frame, seeds, tilted


@given(seeds)
def test_the_camera_turns_about_its_own_place_by_no_more_than_the_tilt(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = make_transform(random_frame(rng), rng.normal(size=3))
    up = tilted(rng, T[:3, 2])
    turned = turn_level(T, up)
    np.testing.assert_allclose(turned[:3, 2], up, atol=1e-12)
    np.testing.assert_allclose(turned[:3, :3] @ turned[:3, :3].T, np.eye(3), atol=1e-12)
    place, moved = invert_transform(T)[:3, 3], invert_transform(turned)[:3, 3]
    np.testing.assert_allclose(moved, place, atol=1e-12)
    turn = Rotation.from_matrix(turned[:3, :3] @ T[:3, :3].T).magnitude()
    np.testing.assert_allclose(turn, np.arccos(min(1.0, T[:3, 2] @ up)), atol=1e-7)
