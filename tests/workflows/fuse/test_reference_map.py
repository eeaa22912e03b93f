"""The reference of Fig. 9: a map of the true ranges."""

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from fusion_core.evaluation.false_cells import evaluate_false_cells, true_views
from fusion_core.evaluation.fuse_folder import open_fuse_folder
from fusion_core.evaluation.map_measures import MapCells
from fusion_core.evaluation.truth import Truth, load_truth
from fusion_core.mapping.grid import GridSettings
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import MappingFailed, ScanLoomError
from fusion_core.workflows.fuse.reference_map import reference_map

SETTINGS = GridSettings()


class TruePoses:
    """The poses of a truth, as though they were recorded."""

    source = "truth"

    def __init__(self, truth: Truth) -> None:
        assert truth.pose is not None
        self._pose_at = dict(zip(truth.scan_stamp_ns.tolist(), truth.pose, strict=True))

    def at(self, stamp_ns: int) -> FloatArray | None:
        return self._pose_at.get(stamp_ns)


class NoPoses:
    source = "nothing"

    def at(self, stamp_ns: int) -> FloatArray | None:
        return None


def test_no_cell_of_the_reference_is_false(bedroom):
    truth = load_truth(bedroom.truth)
    grid = reference_map(bedroom.truth, bedroom.folder, TruePoses(truth), SETTINGS)
    row, column = np.indices(grid.log_odds.shape)
    middle_m = np.array(grid.origin_m) + grid.resolution_m * (
        np.stack([column, row], axis=-1) + 0.5
    )
    views = true_views(truth, open_fuse_folder(bedroom.folder))
    cells = MapCells(
        occupied_m=middle_m[grid.log_odds > 0.0],
        # A ray clears each cell that it touches, also one whose middle it does not reach.
        free_m=middle_m[binary_erosion(grid.log_odds < 0.0)],
        resolution_m=grid.resolution_m,
    )
    found = evaluate_false_cells(cells, views)
    assert found.occupied > 100
    assert found.free > 1000
    assert found.false_occupied == 0
    assert found.false_free <= 0.01 * found.free


def test_without_poses_there_is_no_reference(bedroom):
    with pytest.raises(MappingFailed, match="no cell of the map is known"):
        reference_map(bedroom.truth, bedroom.folder, NoPoses(), SETTINGS)


def test_a_truth_of_another_scanner_is_refused(bedroom, tmp_path):
    with np.load(bedroom.truth) as arrays:
        other = dict(arrays)
    for name in ("scan_true", "scan_kind"):
        other[name] = other[name][:, ::2]
    path = tmp_path / "other.truth.npz"
    np.savez(path, **other)
    with pytest.raises(ScanLoomError, match="beams"):
        reference_map(path, bedroom.folder, NoPoses(), SETTINGS)
