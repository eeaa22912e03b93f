"""Up by the directions of surfaces."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion_core.patches.up_direction import find_up

seeds = st.integers(0, 2**31)
# As far as a guess may be tilted.
MOST_RAD = np.deg2rad(12.0)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def normals_of(
    rng: np.random.Generator, up: np.ndarray, walls: np.ndarray, count: int
) -> np.ndarray:
    """Normals of the floor and of walls (K, 3), each with 2 degrees of noise."""
    clean = np.concatenate([np.tile(up, (count, 1)), np.repeat(walls, count, axis=0)])
    return unit(clean + rng.normal(0.0, np.deg2rad(2.0), clean.shape))


def tilted(rng: np.random.Generator, up: np.ndarray) -> np.ndarray:
    axis = unit(np.cross(up, rng.normal(size=3)))
    turned: np.ndarray = Rotation.from_rotvec(rng.uniform(0.0, MOST_RAD) * axis).apply(up)
    return turned


def random_frame(rng: np.random.Generator) -> np.ndarray:
    return Rotation.random(random_state=rng).as_matrix()


@given(seeds)
def test_up_is_that_of_floor_and_walls(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ahead, left, up = random_frame(rng).T
    # A chair's back leans, and is of neither.
    leaning = np.tile(unit(ahead + up), (300, 1))
    normals = np.concatenate([normals_of(rng, up, np.stack([ahead, left]), 400), leaning])
    found = find_up(rng.permutation(normals), tilted(rng, up))
    assert np.rad2deg(np.arccos(min(1.0, found @ up))) < 0.7


@given(seeds)
def test_a_single_wall_says_nothing_of_a_turn_about_its_normal(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ahead, _, up = random_frame(rng).T
    start = tilted(rng, up)
    normals = normals_of(rng, up, ahead[np.newaxis], 500)[500:]
    found = find_up(normals, start)
    # In the wall's plane, where the start was in it.
    assert abs(found @ ahead) < 0.02
    within = start - (start @ ahead) * ahead
    assert np.rad2deg(np.arccos(min(1.0, found @ unit(within)))) < 2.0


def test_without_any_surface_up_stays() -> None:
    start = unit(np.array([0.1, -1.0, 0.2]))
    np.testing.assert_allclose(find_up(np.empty((0, 3)), start), start, atol=1e-12)
