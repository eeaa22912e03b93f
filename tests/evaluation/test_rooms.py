"""The measures on a real truth: a folder whose labels are the truth's own must score one."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fusion_core.evaluation.alignment import evaluate_alignment
from fusion_core.evaluation.noise import evaluate_noise
from fusion_core.evaluation.repair import evaluate_repair
from fusion_core.evaluation.truth import LeverArm, Truth, load_truth
from fusion_core.model.conventions import Float32Array

pytestmark = pytest.mark.data

# As the rooms' description gives them.
ARM = LeverArm(forward_m=0.05, left_m=0.03, lidar_height_m=0.31, camera_height_m=0.92)
BEAMS, HEIGHT, WIDTH, FOCAL = 682, 240, 320, 288.0
ANGLE_MIN_RAD, STEP_RAD = -2.0892820358276367, 0.006135923787951469
EVERY = 10
HOLE, CONFLICT = 1, 3


@pytest.fixture(scope="module")
def truth(data_folder: Path) -> Truth:
    return load_truth(data_folder / "rooms" / "room_3.truth.npz", lever_arm=ARM)


def _projected(truth: Truth, scan: int) -> Any:
    """Pixels (beams, 2) in which OpenCV sees the true points, NaN behind the camera."""
    mount = truth.cameras[0].T_lidar_camera
    assert mount is not None
    angle_rad = ANGLE_MIN_RAD + STEP_RAD * np.arange(BEAMS)
    points = np.stack([np.cos(angle_rad), np.sin(angle_rad), np.zeros(BEAMS)], axis=-1)
    in_camera = (points * truth.range_m[scan][:, np.newaxis] - mount[:3, 3]) @ mount[:3, :3]
    K = np.array([[FOCAL, 0, (WIDTH - 1) / 2], [0, FOCAL, (HEIGHT - 1) / 2], [0, 0, 1]])
    pixels, _ = cv2.projectPoints(in_camera, np.zeros(3), np.zeros(3), K, None)
    return np.where(in_camera[:, 2:] > 0.0, pixels[:, 0], np.nan)


def _rows(by_hand: Any, truth: Truth) -> list[dict[str, Any]]:
    camera = truth.cameras[0]
    rows = []
    for image in range(0, camera.stamp_ns.size, EVERY):
        scan = int(np.abs(truth.scan_stamp_ns - camera.stamp_ns[image]).argmin())
        for beam, (x, y) in enumerate(np.rint(_projected(truth, scan))):
            if not (0 <= x < WIDTH and 0 <= y < HEIGHT):
                continue
            rows.append(_row(by_hand, truth, (image, scan, beam), (int(y), int(x))))
    return rows


def _row(
    by_hand: Any, truth: Truth, where: tuple[int, int, int], pixel: tuple[int, int]
) -> dict[str, Any]:
    image, scan, beam = where
    camera = truth.cameras[0]
    lidar, depth = int(truth.kind[scan, beam]), int(camera.kind[image, *pixel])
    range_m = float(truth.range_m[scan, beam])
    depth_m = float(camera.depth_mm[image, *pixel]) / 1000.0
    labels = lidar, depth
    if labels == (0, 0) and abs(_seen_from_lidar_m(camera, pixel, depth_m) - range_m) >= 0.10:
        labels = CONFLICT, CONFLICT
    return by_hand.row(
        stamp_ns=int(camera.stamp_ns[image]),
        scan_stamp_ns=int(truth.scan_stamp_ns[scan]),
        lidar_beam=beam,
        depth_row=pixel[0],
        depth_column=pixel[1],
        lidar_class=labels[0],
        depth_class=labels[1],
        lidar_raw_m=None if lidar == HOLE else range_m,
        lidar_repaired_m=range_m,
        lidar_source="other_sensor" if lidar else "raw",
        depth_raw_m=None if depth == HOLE else depth_m,
        depth_repaired_m=depth_m,
        depth_source="neighbours" if depth else "raw",
    )


def _seen_from_lidar_m(camera: Any, pixel: tuple[int, int], depth_m: float) -> float:
    mount = camera.T_lidar_camera
    right_m = (pixel[1] - (WIDTH - 1) / 2) / FOCAL * depth_m
    down_m = (pixel[0] - (HEIGHT - 1) / 2) / FOCAL * depth_m
    x, y, _ = mount[:3, :3] @ [right_m, down_m, depth_m] + mount[:3, 3]
    return float(np.hypot(x, y))


@pytest.fixture
def fused(by_hand: Any, truth: Truth) -> Path:
    rows = _rows(by_hand, truth)
    stamps = dict.fromkeys((row["stamp_ns"], row["scan_stamp_ns"]) for row in rows)
    frames = [
        {"stamp_ns": stamp_ns, "scan_stamp_ns": scan_ns, "u": 83.5, "overlap": 1.0}
        for stamp_ns, scan_ns in stamps
    ]
    lidar = by_hand.lidar(
        beams=BEAMS, angle_min_rad=ANGLE_MIN_RAD, angle_increment_rad=STEP_RAD, samples=240
    )
    cameras = [by_hand.camera(width=WIDTH, height=HEIGHT, focal=FOCAL)]
    path: Path = by_hand.results(
        rows, frames=frames, lidar=lidar, cameras=cameras, yaw_rad=np.deg2rad(7.0)
    )
    return path


def test_labels_from_the_truth_score_one(fused: Path, truth: Truth) -> None:
    report = evaluate_noise(fused, truth).to_json()
    for name in ("xi", "eta", "attribution", "conflict_recall", "lidar_hole_recall"):
        assert report[name] == 1.0, name
    assert report["conflict_changed"] == 0.0
    assert report["good_pairs"] > 500
    assert report["noise_pairs"] > 5


def test_true_offset_lies_where_yaw_and_lever_arm_put_it(fused: Path, truth: Truth) -> None:
    report = evaluate_alignment(fused, truth)
    # 7 degrees left of straight ahead, where a level camera of 58.1 degrees starts at u = 90.9;
    # the lever arm turns that by 0.4 (at 3.5 m) to 1.2 degrees (at 1 m).
    assert np.nanmin(report.u_true) > 82.5
    assert np.nanmax(report.u_true) < 84.0
    assert report.hits["u"].fraction == 1.0
    assert report.yaw_error_deg == pytest.approx(0.0, abs=1e-6)


def test_repairs_from_the_truth_have_no_error_and_baselines_have(fused: Path, truth: Truth) -> None:
    camera = truth.cameras[0]

    def images(topic: str) -> Iterator[tuple[str, int, Float32Array]]:
        for image, stamp_ns in enumerate(camera.stamp_ns):
            depth_m = camera.depth_mm[image] / np.float32(1000.0)
            depth_m[camera.kind[image] == HOLE] = np.nan
            yield topic, int(stamp_ns), depth_m

    report = evaluate_repair(fused, truth, images("/camera/depth/image_raw")).to_json()
    for sensor, baselines in (("lidar", ("linear",)), ("depth", ("inpaint", "nearest"))):
        wide = report[sensor]["wide"]
        assert wide["repaired"] == 1.0
        assert wide["own"]["rms_m"] == pytest.approx(0.0, abs=1e-9)
        assert report[sensor]["moved_farther"] == 0.0
        assert all(wide[baseline]["median_m"] > 1e-4 for baseline in baselines)
