"""Maps from placed scans: poses between stamps, and none where nobody knows them."""

import numpy as np
import pytest

from fusion_core.mapping.grid import GridSettings
from fusion_core.model.progress import silent
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.map.estimators import PlacedScans
from fusion_core.workflows.map.occupancy_maps import build_maps
from fusion_core.workflows.map.write_results import write_maps

SECOND = 1_000_000_000


def placed() -> PlacedScans:
    return PlacedScans(
        stamps_ns=np.array([0, SECOND, 9 * SECOND]),
        poses_map_scan=np.array([[0.0, 0.0, 3.0], [1.0, 2.0, -3.0], [5.0, 2.0, 0.0]]),
        trusted=np.ones(3, dtype=np.bool_),
        seconds={},
    )


class Walls:
    """A wall three metres ahead of each stamp."""

    frame_id = "laser"
    notes = ()

    def __init__(self, stamps_ns, range_m=3.0):
        self.stamps_ns, self.range_m = stamps_ns, range_m

    def __iter__(self):
        for stamp_ns in self.stamps_ns:
            yield LaserScan(
                stamp_ns=stamp_ns,
                received_ns=stamp_ns,
                frame_id="laser",
                angle_min_rad=-0.1,
                angle_increment_rad=0.02,
                range_min_m=0.1,
                range_max_m=10.0,
                ranges_m=np.full(11, self.range_m),
            )


def test_a_pose_between_two_stamps_takes_the_shorter_turn():
    np.testing.assert_allclose(placed().pose_at(SECOND), [1.0, 2.0, -3.0])
    half = placed().pose_at(SECOND // 2)
    np.testing.assert_allclose(half[:2], [0.5, 1.0])
    assert abs(half[2]) == pytest.approx(np.pi)


@pytest.mark.parametrize("stamp_ns", [-1, 2 * SECOND, 9 * SECOND + 1])
def test_outside_and_in_gaps_there_is_none(stamp_ns):
    assert placed().pose_at(stamp_ns) is None


def test_each_source_gives_a_map_on_one_raster(tmp_path):
    sources = {"lidar": Walls([0, SECOND]), "merged": Walls([0, SECOND // 2], 2.0)}
    grids, notes = build_maps(sources, placed(), GridSettings(), 20.0, silent)
    assert list(grids) == ["lidar", "merged"]
    assert notes == []
    write_maps(tmp_path, grids, "two walls")
    names = {path.name for path in tmp_path.iterdir()}
    assert {"map_lidar.yaml", "map_merged.yaml", "map_difference.png", "maps.png"} <= names


def test_a_source_without_poses_is_noted():
    sources = {"lidar": Walls([0]), "camera": Walls([5 * SECOND])}
    grids, notes = build_maps(sources, placed(), GridSettings(), 20.0, silent)
    assert list(grids) == ["lidar"]
    assert notes[0].startswith("No camera map")
