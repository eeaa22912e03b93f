"""Common hole filling: nearest pixels against a search, inpainting on what it must reproduce."""

import numpy as np
import pytest

from fusion_core.evaluation.depth_baselines import fill_by_baselines


@pytest.mark.parametrize("seed", range(4))
def test_nearest_is_as_near_as_any_valid_pixel(seed: int) -> None:
    rng = np.random.default_rng(seed)
    depth_m = rng.uniform(1.0, 4.0, (12, 17)).astype(np.float32)
    depth_m[rng.random(depth_m.shape) < 0.6] = np.nan
    row, column = map(np.ravel, np.indices(depth_m.shape))
    filled = fill_by_baselines(depth_m, row, column)["nearest"]
    valid_row, valid_column = np.nonzero(np.isfinite(depth_m))
    for r, c, value_m in zip(row, column, filled, strict=True):
        squared = (valid_row - r) ** 2 + (valid_column - c) ** 2
        tied = depth_m[valid_row, valid_column][squared == squared.min()]
        assert value_m in tied.astype(np.float64)


def test_a_hole_in_a_plain_wall_is_filled_with_the_wall() -> None:
    depth_m = np.full((60, 80), 2.5, np.float32)
    depth_m[20:40, 30:50] = np.nan
    row, column = np.array([20, 30, 39]), np.array([30, 40, 49])
    for name, value_m in fill_by_baselines(depth_m, row, column).items():
        np.testing.assert_allclose(value_m, 2.5, atol=0.005, err_msg=name)


def test_pixels_with_a_value_keep_it() -> None:
    depth_m = np.linspace(1.0, 3.0, 80, dtype=np.float32).reshape(8, 10)
    depth_m[3, 4] = np.nan
    row, column = np.array([0, 7]), np.array([0, 9])
    for name, value_m in fill_by_baselines(depth_m, row, column).items():
        np.testing.assert_allclose(value_m, [1.0, 3.0], rtol=1e-6, err_msg=name)


def test_where_nothing_is_valid_nothing_is_filled() -> None:
    empty = np.full((90, 10), np.nan, np.float32)
    at = np.array([1]), np.array([2])
    assert all(np.isnan(value_m).all() for value_m in fill_by_baselines(empty, *at).values())
    # Valid far below what inpainting reads: nearest still finds it.
    empty[89] = 2.0
    filled = fill_by_baselines(empty, *at)
    assert np.isnan(filled["inpaint"]).all()
    assert filled["nearest"].tolist() == [2.0]
