"""The trajectory on the map and N_eff over time."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from fusion_core.exporting.figures_slam import write_effective_particles, write_trajectory_figure
from fusion_core.exporting.palette import BURR, DEPTH, LIDAR
from fusion_core.model.grids import OccupancyGrid

POSES = np.array([[0.5, 0.5, 0.0], [3.0, 0.5, 1.6], [3.0, 1.5, 3.1], [0.5, 1.5, -1.6]])
LOOPS = np.array([[0.5, 1.5, 0.5, 0.5]])


def grid() -> OccupancyGrid:
    log_odds = np.full((20, 40), -2.0)
    log_odds[0] = log_odds[-1] = 3.0
    log_odds[:, 30:] = np.nan
    return OccupancyGrid(resolution_m=0.1, origin_m=(0.0, 0.0), log_odds=log_odds)


def has(path: Path, color: str) -> bool:
    """Whether a colour, or one close to it, is in a picture."""
    return count(path, color) > 0


def count(path: Path, color: str) -> int:
    """How many pixels have a colour, or one close to it."""
    image = cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)
    assert image is not None
    wanted = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)])
    return int((np.abs(image.astype(int) - wanted).max(axis=2) < 24).sum())


@pytest.mark.parametrize("trusted", [True, False])
def test_trajectory_loops_and_untrusted_scans_have_their_colours(
    tmp_path: Path, trusted: bool
) -> None:
    path = tmp_path / "trajectory.png"
    write_trajectory_figure(
        path, "a room", grid(), POSES, np.array([True, True, trusted, True]), LOOPS
    )
    assert has(path, DEPTH)
    assert has(path, LIDAR)
    assert has(path, BURR) is not trusted


def test_trajectory_without_map_or_loops(tmp_path: Path) -> None:
    path = tmp_path / "trajectory.png"
    write_trajectory_figure(
        path, "a room", None, POSES[:1], np.ones(1, dtype=np.bool_), np.zeros((0, 4))
    )
    assert path.stat().st_size > 1000
    assert not has(path, LIDAR)


def test_same_bytes_twice(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        write_trajectory_figure(
            tmp_path / name, "a", grid(), POSES, np.ones(4, dtype=np.bool_), LOOPS
        )
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_effective_number_and_each_resampling(tmp_path: Path) -> None:
    stamps_ns = np.arange(5, dtype=np.int64) * 10**9
    effective = np.array([30.0, 20.0, 14.0, 30.0, 25.0])
    once, twice = tmp_path / "once.png", tmp_path / "twice.png"
    write_effective_particles(once, "a room", stamps_ns, effective, effective < 15.0, 30)
    write_effective_particles(twice, "a room", stamps_ns, effective, effective < 21.0, 30)
    assert has(once, DEPTH)
    assert count(twice, BURR) > count(once, BURR) > 0
