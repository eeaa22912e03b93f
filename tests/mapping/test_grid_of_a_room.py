"""A map of a recorded room, against the true end points of its beams."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fusion_core.mapping.grid import GridBuilder, GridSettings
from fusion_core.model.sensors import LaserScan
from fusion_core.recordings.formats import open_recording


@pytest.mark.data
def test_obstacles_lie_where_the_beams_truly_ended(room_path: Path, room_truth_path: Path) -> None:
    truth = dict(np.load(room_truth_path))
    with open_recording(room_path) as recording:
        scans = [m.value for m in recording.messages(["/scan"]) if isinstance(m.value, LaserScan)]
    assert len(scans) == len(truth["pose"])
    builder = GridBuilder(GridSettings())
    ends_m, errors_m = [], []
    for scan, pose, true_m, kind in zip(
        scans, truth["pose"], truth["scan_true"], truth["scan_kind"], strict=True
    ):
        good = kind == 0
        builder.add_scan(
            pose, scan.angles_rad, np.where(good, scan.ranges_m, np.nan), scan.range_max_m
        )
        azimuths_rad = scan.angles_rad[good] + pose[2]
        directions = np.stack([np.cos(azimuths_rad), np.sin(azimuths_rad)], axis=1)
        errors_m.append(float(np.nanmax(np.abs(scan.ranges_m - true_m)[good])))
        ends_m.append(pose[:2] + true_m[good, np.newaxis] * directions)
    grid = builder.build()
    occupied = np.argwhere(grid.probability > 0.65)
    centres_m = (occupied[:, ::-1] + 0.5) * grid.resolution_m + grid.origin_m
    distance_m, _ = cKDTree(np.concatenate(ends_m)).query(centres_m)
    assert len(occupied) > 200
    # A beam's end is off by its range error, a cell's centre from an end in it by half a diagonal.
    half_diagonal_m = grid.resolution_m / np.sqrt(2.0)
    assert distance_m.max() < max(errors_m) + half_diagonal_m
    assert np.quantile(distance_m, 0.99) < 3.0 * grid.resolution_m
