"""Two curves on paper: where they are drawn, and where nothing is."""

import numpy as np
import pytest

from scanloom.plots.curves_picture import curves_picture
from scanloom.plots.palette import color_of

SIZE = {"width_px": 400, "height_px": 240}


def count(rgb: np.ndarray, name: str) -> int:
    """Pixels of a sensor's colour, above the legend."""
    near = np.abs(rgb[:190].astype(int) - np.array(color_of(name))).max(axis=-1) <= 2
    return int(near.sum())


def test_each_curve_has_its_colour_and_a_gap_is_white() -> None:
    lidar, depth = np.full(40, 2.0), np.full(40, 3.0)
    whole = curves_picture(lidar, depth, **SIZE)
    assert whole.shape == (240, 400, 3)
    lidar[10:30] = np.nan
    broken = curves_picture(lidar, depth, **SIZE)
    assert count(broken, "lidar") < 0.7 * count(whole, "lidar")
    assert count(broken, "depth") == count(whole, "depth") > 300


def test_nearer_is_lower() -> None:
    rgb = curves_picture(np.full(40, 2.0), np.full(40, 3.0), **SIZE)
    rows = {
        name: np.flatnonzero(
            (np.abs(rgb[:190].astype(int) - color_of(name)).max(axis=-1) <= 2).any(1)
        )
        for name in ("lidar", "depth")
    }
    assert rows["lidar"].min() > rows["depth"].max()


@pytest.mark.parametrize("value", [np.nan, 2.5])
def test_nothing_and_one_value_can_be_drawn(value: float) -> None:
    curves = np.full(40, np.nan)
    curves[7] = value
    rgb = curves_picture(curves, np.full(40, np.nan), **SIZE)
    assert (count(rgb, "lidar") > 0) == bool(np.isfinite(value))
