"""Themes: legible text and frames, and pictures that are dark all over where the page is dark."""

from collections.abc import Callable

import numpy as np
import pytest

from fusion_core.model.conventions import ByteArray
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.slam_view import SlamView
from scanloom.plots.depth_image import depth_picture
from scanloom.plots.grid_image import grid_texture
from scanloom.plots.heatmap import heatmap
from scanloom.plots.pair_plot import PairPlot, pair_picture
from scanloom.plots.run_comparison import RunOnMap, comparison_picture
from scanloom.plots.score_field import Mark
from scanloom.plots.slam_progress import slam_progress_picture
from scanloom.plots.theme import DARK, LIGHT, Theme, theme_of
from tests.app.plots.color_vision import contrast
from tests.app.plots.test_heatmap import ramp

_POSES = np.column_stack([np.linspace(0.0, 2.0, 20), np.zeros(20), np.zeros(20)])
_SIZE = {"width_px": 440, "height_px": 500}


def grid() -> OccupancyGrid:
    log_odds = np.array([[-9.0, 9.0, np.nan], [0.0, -9.0, np.nan]])
    return OccupancyGrid(resolution_m=0.5, origin_m=(0.0, -1.0), log_odds=log_odds)


def _heatmap(theme: Theme) -> ByteArray:
    marks = [Mark("peak", 3.0, 4.0), Mark("prior", 9.0)]
    # So low that its field leaves some ground.
    return heatmap(ramp(), marks, theme=theme, width_px=440, height_px=120).rgb


def _depth(theme: Theme) -> ByteArray:
    depth_m = np.full((40, 60), np.nan, dtype=np.float32)
    depth_m[:, :20] = np.linspace(1.0, 2.0, 20)
    return depth_picture("Depth", depth_m, theme=theme, **_SIZE).rgb


def _pairs(theme: Theme) -> ByteArray:
    points_m = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 2))
    plot = PairPlot(title="Pairs", lidar_m=points_m, depth_m=points_m + 0.05)
    return pair_picture([plot], theme=theme, **_SIZE).rgb


def _slam(theme: Theme) -> ByteArray:
    view = SlamView(
        stage="matching scans",
        stamps_ns=np.arange(20),
        poses_map_scan=_POSES,
        particles=_POSES[-3:],
        weights=np.full(3, 1.0 / 3.0),
        effective=np.full(20, 3.0),
        loops_m=np.empty((0, 4)),
    )
    window = np.array([-1.0, -2.0]), np.array([3.0, 2.0])
    return slam_progress_picture(view, window, theme=theme, **_SIZE)


def _comparison(theme: Theme) -> ByteArray:
    run = RunOnMap(title="Run", stamps_ns=np.arange(20), poses=_POSES, grid=grid())
    return comparison_picture(run, run, second_in_first=np.zeros(3), theme=theme, **_SIZE)


@pytest.mark.parametrize("theme", [LIGHT, DARK], ids=["light", "dark"])
def test_text_and_frames_can_be_read_on_the_background(theme: Theme) -> None:
    assert contrast(theme.ink, theme.background) >= 7.0
    assert contrast(theme.neutral, theme.background) >= 4.5
    assert contrast(theme.fused, theme.background) >= 7.0
    assert contrast(theme.grey, theme.background) >= 3.0
    for faint in (theme.grid, *theme.hatch):
        assert 1.05 < contrast(faint, theme.background) < 2.5


@pytest.mark.parametrize("draw", [_heatmap, _depth, _pairs, _slam, _comparison])
def test_a_dark_picture_has_no_light_ground(draw: Callable[[Theme], ByteArray]) -> None:
    light, dark = draw(LIGHT), draw(DARK)
    assert light.shape == dark.shape
    # Not the same picture: each pixel of the light ground is dark.
    ground = (light == LIGHT.background).all(axis=2)
    assert ground.mean() > 0.2
    assert dark[ground].mean() < 60.0
    assert np.median(dark[ground], axis=0).tolist() == list(DARK.background)
    edge = (dark[0] == DARK.edge).all(axis=1)
    assert edge.all()


def test_obstacles_stand_out_of_free_and_of_unknown_cells_of_a_map() -> None:
    for theme in (LIGHT, DARK):
        texture = grid_texture(grid(), theme)
        assert texture[1].tolist() == [
            list(color) for color in (theme.free, theme.obstacle, theme.unknown)
        ]
        for other in (theme.free, theme.unknown):
            assert contrast(theme.obstacle, other) > 5.0


def test_a_page_chooses_its_theme() -> None:
    assert theme_of(is_dark=True) is DARK
    assert theme_of(is_dark=False) is LIGHT
