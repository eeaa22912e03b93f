"""A pose that is turned to the up that its camera sees."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion_core.calibration.planar.level_start import turn_level
from fusion_core.model.geometry import invert_transform, make_transform

seeds = st.integers(0, 2**31)
# As far as a guess may be tilted.
MOST_RAD = np.deg2rad(12.0)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def tilted(rng: np.random.Generator, up: np.ndarray) -> np.ndarray:
    axis = unit(np.cross(up, rng.normal(size=3)))
    turned: np.ndarray = Rotation.from_rotvec(rng.uniform(0.0, MOST_RAD) * axis).apply(up)
    return turned


def random_frame(rng: np.random.Generator) -> np.ndarray:
    return Rotation.random(random_state=rng).as_matrix()


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
