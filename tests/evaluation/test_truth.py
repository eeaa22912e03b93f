"""Reading a truth file: its values come out, and invalid files are refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fusion_core.evaluation import truth_arrays
from fusion_core.evaluation.truth import LeverArm, load_truth
from fusion_core.model.errors import ScanLoomError
from tests.hostile.files import write_huge_array


def _arrays() -> dict[str, Any]:
    return {
        "scan_stamp": np.array([5, 15], np.int64),
        "scan_true": np.array([[1.0, 0.0, 2.0], [np.nan, 3.0, np.inf]], np.float32),
        "scan_kind": np.array([[0, 1, 2], [1, 0, 1]], np.uint8),
        "depth_stamp": np.array([7], np.int64),
        "depth_true": np.array([[[1500, 0]]], np.uint16),
        "depth_kind": np.array([[[0, 1]]], np.uint8),
        "cam_yaw": np.float64(0.25),
    }


def _written(folder: Path, arrays: dict[str, Any]) -> Path:
    path = folder / "truth.npz"
    np.savez(path, **arrays)
    return path


def test_values_come_out_in_metres_with_nan_for_none(tmp_path: Path) -> None:
    truth = load_truth(_written(tmp_path, _arrays()))
    np.testing.assert_array_equal(truth.range_m, [[1.0, np.nan, 2.0], [np.nan, 3.0, np.nan]])
    (camera,) = truth.cameras
    zero = np.array([0, 0])
    np.testing.assert_array_equal(camera.depth_m(zero, zero, np.array([0, 1])), [1.5, np.nan])
    assert truth.angle_min_rad is None
    assert truth.clock_offset_ms is None
    assert camera.topic is None
    assert camera.intrinsics is None
    assert camera.T_lidar_camera is None


def test_lever_arm_makes_the_mount_with_the_truths_yaw(tmp_path: Path) -> None:
    arm = LeverArm(forward_m=0.05, left_m=0.03, lidar_height_m=0.31, camera_height_m=0.92)
    mount = load_truth(_written(tmp_path, _arrays()), lever_arm=arm).cameras[0].T_lidar_camera
    assert mount is not None
    np.testing.assert_allclose(mount[:3, 3], [0.05, 0.03, 0.61])
    # The optical axis looks 0.25 rad to the left, the image's right side to the right.
    np.testing.assert_allclose(mount[:3, 2], [np.cos(0.25), np.sin(0.25), 0.0], atol=1e-12)
    np.testing.assert_allclose(mount[:3, 0], [np.sin(0.25), -np.cos(0.25), 0.0], atol=1e-12)
    np.testing.assert_allclose(mount[:3, 1], [0.0, 0.0, -1.0], atol=1e-12)


def test_pitch_of_the_lever_arm_looks_down() -> None:
    arm = LeverArm(
        forward_m=0.0, left_m=0.0, lidar_height_m=0.3, camera_height_m=0.3, pitch_rad=0.1
    )
    np.testing.assert_allclose(arm.mount(0.0)[:3, 2], [np.cos(0.1), 0.0, -np.sin(0.1)], atol=1e-12)


def test_mount_and_clock_of_the_file_take_precedence(tmp_path: Path) -> None:
    own = np.eye(4)[np.newaxis] * [[[2.0], [2.0], [2.0], [1.0]]]
    arrays = _arrays() | {"T_lidar_camera": own, "clock_offset_ms": np.float64(40.0)}
    arm = LeverArm(forward_m=1.0, left_m=1.0, lidar_height_m=0.0, camera_height_m=1.0)
    truth = load_truth(_written(tmp_path, arrays), lever_arm=arm, clock_offset_ms=-3.0)
    assert truth.clock_offset_ms == 40.0
    np.testing.assert_array_equal(truth.cameras[0].T_lidar_camera, own[0])


def test_a_clock_by_hand_is_used_where_the_file_has_none(tmp_path: Path) -> None:
    assert load_truth(_written(tmp_path, _arrays()), clock_offset_ms=-3.0).clock_offset_ms == -3.0


def test_several_cameras_and_all_optional_arrays(tmp_path: Path) -> None:
    arrays = _arrays()
    for name in ("depth_true", "depth_kind", "depth_stamp"):
        one = arrays.pop(name)
        arrays |= {f"{name}_0": one, f"{name}_1": one}
    arrays["depth_stamp_1"] = np.array([9], np.int64)
    arrays |= {
        "camera_topics": np.array(["/left", "/right"]),
        "intrinsics": np.array([[10.0, 11.0, 0.5, 0.0], [20.0, 21.0, 0.5, 0.0]]),
        "T_lidar_camera": np.stack([np.eye(4), 2 * np.eye(4)]),
        "cam_yaw": np.array([0.1, 0.2]),
        "lidar_angle_min": np.float64(-1.0),
        "lidar_angle_increment": np.float64(0.5),
    }
    truth = load_truth(_written(tmp_path, arrays))
    assert (truth.angle_min_rad, truth.angle_increment_rad) == (-1.0, 0.5)
    left, right = truth.cameras
    assert (left.topic, right.topic) == ("/left", "/right")
    assert right.intrinsics == (20.0, 21.0, 0.5, 0.0)
    assert right.stamp_ns.tolist() == [9]
    np.testing.assert_array_equal(right.T_lidar_camera, 2 * np.eye(4))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scan_true": None}, "scan_true"),
        ({"depth_true": None}, "depth_true"),
        ({"scan_stamp": np.array([5], np.int64)}, "scan_true"),
        ({"scan_stamp": np.array([5.0, 15.0])}, "integer nanoseconds"),
        ({"scan_kind": np.full((2, 3), 3, np.uint8)}, "scan_kind"),
        ({"scan_kind": np.zeros((2, 4), np.uint8)}, "scan_kind"),
        ({"depth_true": np.zeros((1, 2), np.uint16)}, "depth_true"),
        ({"depth_true": np.full((1, 1, 2), "x")}, "depth_true"),
        ({"T_lidar_camera": np.eye(3)}, "T_lidar_camera"),
        ({"intrinsics": np.zeros((2, 4))}, "intrinsics"),
    ],
)
def test_an_invalid_array_is_named(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    arrays = {key: array for key, array in (_arrays() | change).items() if array is not None}
    path = _written(tmp_path, arrays)
    with pytest.raises(ScanLoomError, match=message) as caught:
        load_truth(path)
    assert caught.value.file == str(path)


def test_a_file_that_is_not_npz_is_a_typed_error(tmp_path: Path) -> None:
    text, single = tmp_path / "text.npz", tmp_path / "single.npy"
    text.write_text("not a truth")
    np.save(single, np.zeros(3))
    for path in (text, single, tmp_path / "absent.npz"):
        with pytest.raises(ScanLoomError, match="truth"):
            load_truth(path)


def test_an_array_without_end_is_a_typed_error(tmp_path: Path) -> None:
    with pytest.raises(ScanLoomError, match="cannot be read as a truth file"):
        load_truth(write_huge_array(tmp_path / "huge.npz"))


def test_an_archive_larger_than_the_limit_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = _written(tmp_path, _arrays())
    monkeypatch.setattr(truth_arrays, "_MAX_UNPACKED_BYTES", 100)
    with pytest.raises(ScanLoomError, match="unpacks to more than 100 bytes"):
        load_truth(path)
    monkeypatch.setattr(truth_arrays, "_MAX_PACKED_BYTES", 100)
    with pytest.raises(ScanLoomError, match="larger than 100 bytes"):
        load_truth(path)
