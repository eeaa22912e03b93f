"""The whole chain on rooms of another simulator, at the bars that it must hold."""

import numpy as np
import pytest

from fusion_core.workflows.evaluate import evaluate
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions

pytestmark = pytest.mark.data

ARM = (0.05, 0.03, 0.61)


@pytest.fixture(scope="module")
def room_3(data_folder, tmp_path_factory):
    """Nothing is known of this one's mount."""
    rooms = data_folder / "rooms"
    output = tmp_path_factory.mktemp("room_3") / "out"
    fuse(rooms / "room_3", output, FuseOptions(figures=False))
    return output, rooms / "room_3.truth.npz"


def test_yaw_and_offsets(room_3):
    measured = evaluate.alignment(*room_3, lever_arm_m=ARM)
    assert abs(measured["yaw_error_deg"]) <= 1.0
    assert measured["frames_with_true_u"] == 90
    assert measured["within_2_samples"]["u"]["share"] >= 0.95


def test_noise(room_3):
    measured = evaluate.noise(*room_3, lever_arm_m=ARM)
    assert measured["xi"] >= 0.965
    assert measured["eta"] >= 0.84
    assert measured["attribution"] >= 0.89
    assert measured["noise_pairs"] > 100


def test_repairs(room_3):
    measured = evaluate.repair(*room_3, lever_arm_m=ARM)
    wide, narrow = measured["lidar"]["wide"]["linear"], measured["lidar"]["narrow"]["linear"]
    assert wide["own_to_median"] <= 0.63
    assert wide["own_to_p90"] <= 1.02
    assert narrow["own_to_median"] <= 1.02
    assert narrow["own_to_p90"] <= 1.02
    assert measured["lidar"]["moved_farther"] <= 0.001
    by_source = measured["lidar"]["by_source"]
    assert by_source["all"]["behind_surface"] <= 0.002
    assert by_source["neighbours"]["behind_surface"] <= 0.01
    assert measured["lidar"]["holes_filled"] >= 0.87


@pytest.mark.slow
def test_a_late_clock_lies_in_its_interval(data_folder, tmp_path):
    rooms = data_folder / "rooms"
    fuse(rooms / "room_2.bag", tmp_path / "out", FuseOptions(maps=False, figures=False))
    measured = evaluate.alignment(
        tmp_path / "out", rooms / "room_2.truth.npz", lever_arm_m=ARM, clock_offset_ms=40.0
    )
    assert measured["clock_contains_truth"] is True
    assert abs(measured["yaw_error_deg"]) <= 1.0
    low_ms, high_ms = measured["clock_interval_ms"]
    assert np.isfinite([low_ms, high_ms]).all()
    assert high_ms - low_ms <= 60.0
