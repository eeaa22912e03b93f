"""True offsets in closed form and by a loop; hits, mount and clock by hand."""

from math import atan, atan2, cos, degrees, hypot, radians, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fusion_core.evaluation.alignment import evaluate_alignment, pool_hits
from fusion_core.evaluation.truth import LeverArm, Truth, load_truth

BEAMS = 241
HEIGHT, WIDTH, FOCAL = 5, 401, 400.0
RADIUS_M = 2.0
LEFT_EDGE_DEG = degrees(atan(0.5 * WIDTH / FOCAL))

# The columns' depths of a round room around the camera.
ROUND_MM = (
    1000.0 * RADIUS_M * np.cos(np.arctan((np.arange(WIDTH) - (WIDTH - 1) / 2) / FOCAL))
) * np.ones((1, HEIGHT, 1))


def _round_room(by_hand: Any, yaw_deg: float, **arrays: Any) -> Truth:
    """LiDAR and camera in the middle of a round room: every pair is good."""
    own = {
        "scan_true": np.full((1, BEAMS), RADIUS_M),
        "scan_kind": np.zeros((1, BEAMS), np.uint8),
        "depth_true": ROUND_MM,
        "depth_kind": np.zeros(ROUND_MM.shape, np.uint8),
        "T_lidar_camera": None,
        "cam_yaw": np.float64(radians(yaw_deg)),
    }
    arm = LeverArm(forward_m=0.0, left_m=0.0, lidar_height_m=0.3, camera_height_m=0.3)
    return load_truth(by_hand.truth(**(own | arrays)), lever_arm=arm)


def _results(by_hand: Any, *frames: dict[str, Any], **alignment: Any) -> Path:
    cameras = alignment.pop("cameras", [by_hand.camera(width=WIDTH, height=HEIGHT, focal=FOCAL)])
    lidar = alignment.pop("lidar", by_hand.lidar(beams=BEAMS))
    return by_hand.results(
        [], lidar=lidar, cameras=cameras, frames=list(frames) or [{}], **alignment
    )


@pytest.mark.parametrize("yaw_deg", [-30.0, 0.0, 7.0])
def test_true_u_of_a_camera_at_the_lidars_origin_is_the_angle_between_their_left_ends(
    by_hand: Any, yaw_deg: float
) -> None:
    truth = _round_room(by_hand, yaw_deg)
    expected = 120.0 - (yaw_deg + LEFT_EDGE_DEG - 0.5)
    report = evaluate_alignment(_results(by_hand), truth)
    assert report.u_true == pytest.approx(expected, abs=0.05)


def test_true_u_counts_in_samples_of_the_curve(by_hand: Any) -> None:
    lidar = by_hand.lidar(beams=BEAMS, samples=482)
    report = evaluate_alignment(_results(by_hand, lidar=lidar), _round_room(by_hand, 0.0))
    # Sample 0 lies a quarter of a degree inside the first beam's left edge at 120.5 degrees.
    expected = (120.25 - (LEFT_EDGE_DEG - 0.25)) / 0.5
    assert report.u_true == pytest.approx(expected, abs=0.1)


def test_beams_that_run_clockwise_give_the_same_offset(by_hand: Any) -> None:
    lidar = by_hand.lidar(
        beams=BEAMS, angle_min_rad=radians(120.0), angle_increment_rad=-radians(1.0)
    )
    clockwise = evaluate_alignment(_results(by_hand, lidar=lidar), _round_room(by_hand, 7.0))
    counter = evaluate_alignment(_results(by_hand), _round_room(by_hand, 7.0))
    assert clockwise.u_true == pytest.approx(counter.u_true, abs=0.05)


def test_a_camera_on_its_side_counts_along_its_columns(by_hand: Any) -> None:
    yaw = radians(7.0)
    # The image's x axis looks up, its y axis to the right.
    mount = np.array(
        [
            [0.0, sin(yaw), cos(yaw), 0.0],
            [0.0, -cos(yaw), sin(yaw), 0.0],
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    depth_mm = np.swapaxes(ROUND_MM, 1, 2)
    truth = _round_room(
        by_hand,
        7.0,
        depth_true=depth_mm,
        depth_kind=np.zeros(depth_mm.shape, np.uint8),
        T_lidar_camera=mount,
    )
    camera = by_hand.camera(width=HEIGHT, height=WIDTH, focal=FOCAL)
    report = evaluate_alignment(_results(by_hand, cameras=[camera]), truth)
    assert report.u_true == pytest.approx(120.0 - (7.0 + LEFT_EDGE_DEG - 0.5), abs=0.05)


@pytest.fixture
def two_cameras(by_hand: Any) -> tuple[list[dict[str, Any]], Truth]:
    """Cameras that look 27 degrees left and 13 degrees right, each said to look 0.5 farther left
    and 0.25 lower."""
    topics = ["/left", "/right"]
    yaws_deg = [27.0, -13.0]
    level, lower = (
        LeverArm(
            forward_m=0.0,
            left_m=0.0,
            lidar_height_m=0.0,
            camera_height_m=0.0,
            pitch_rad=radians(pitch_deg),
        )
        for pitch_deg in (0.0, 0.25)
    )
    truth = _round_room(
        by_hand,
        0.0,
        depth_true=None,
        depth_kind=None,
        depth_stamp=np.array([0]),
        **{f"depth_true_{n}": ROUND_MM for n in range(2)},
        **{f"depth_kind_{n}": np.zeros(ROUND_MM.shape, np.uint8) for n in range(2)},
        camera_topics=np.array(topics),
        cam_yaw=np.float64(radians(7.0)),
        T_lidar_camera=np.stack([level.mount(radians(yaw)) for yaw in yaws_deg]),
    )
    cameras = [
        by_hand.camera(
            width=WIDTH,
            height=HEIGHT,
            focal=FOCAL,
            topic=topic,
            T_lidar_camera=lower.mount(radians(yaw + 0.5)).tolist(),
        )
        for topic, yaw in zip(topics, yaws_deg, strict=True)
    ]
    return cameras, truth


def test_cameras_of_a_rig_share_the_offset_of_their_panorama(
    by_hand: Any, two_cameras: tuple[list[dict[str, Any]], Truth]
) -> None:
    cameras, truth = two_cameras
    frames = [{"camera": camera["topic"]} for camera in cameras]
    report = evaluate_alignment(_results(by_hand, *frames, cameras=cameras), truth)
    expected = 120.0 - (27.0 + LEFT_EDGE_DEG - 0.5)
    assert report.u_true == pytest.approx([expected, expected], abs=0.05)


def test_the_error_of_a_rig_is_that_of_its_cameras_headings(
    by_hand: Any, two_cameras: tuple[list[dict[str, Any]], Truth]
) -> None:
    cameras, truth = two_cameras
    frame = {"camera": "/left"}
    path = _results(by_hand, frame, cameras=cameras, yaw_rad=1.0, forward_m=0.1, left_m=-0.2)
    error = evaluate_alignment(path, truth).mount_error
    assert error == {
        "forward_m": pytest.approx(0.1),
        "left_m": pytest.approx(-0.2),
        "delta_z_m": None,
        "yaw_rad": pytest.approx(radians(0.5)),
        "pitch_rad": pytest.approx(radians(0.25)),
    }
    unknown = [camera | {"T_lidar_camera": None} for camera in cameras]
    path = _results(by_hand, frame, cameras=unknown, yaw_rad=1.0)
    assert evaluate_alignment(path, truth).yaw_error_deg is None


ARM = LeverArm(forward_m=0.2, left_m=-0.3, lidar_height_m=0.3, camera_height_m=0.31)


def _offsets_by_loop(
    ranges_m: Any, beam_kind: Any, depth_mm: Any, depth_kind: Any, yaw: float
) -> list[float]:
    offsets = []
    left_deg = LEFT_EDGE_DEG - 0.5
    cx, cy = (WIDTH - 1) / 2, (HEIGHT - 1) / 2
    for beam, range_m in enumerate(ranges_m):
        angle = radians(beam - 120.0)
        x, y = range_m * cos(angle) - ARM.forward_m, range_m * sin(angle) - ARM.left_m
        ahead = cos(yaw) * x + sin(yaw) * y
        to_left = -sin(yaw) * x + cos(yaw) * y
        if beam_kind[beam] != 0 or ahead <= 0:
            continue
        column = round(cx - FOCAL * to_left / ahead)
        row = round(cy + FOCAL * 0.01 / ahead)
        if not (0 <= column < WIDTH and 0 <= row < HEIGHT) or depth_kind[row, column] != 0:
            continue
        z = depth_mm[row, column] / 1000.0
        left_m = (cx - column) / FOCAL * z
        seen_x = ARM.forward_m + cos(yaw) * z - sin(yaw) * left_m
        seen_y = ARM.left_m + sin(yaw) * z + cos(yaw) * left_m
        if abs(hypot(seen_x, seen_y) - range_m) < 0.10:
            azimuth_deg = degrees(atan2(left_m, z))
            offsets.append((240 - beam) - (left_deg - azimuth_deg))
    return offsets


@pytest.mark.parametrize("seed", range(4))
def test_true_u_with_a_lever_arm_and_noise_equals_that_of_a_loop(by_hand: Any, seed: int) -> None:
    rng = np.random.default_rng(seed)
    ranges_m = 2.0 + rng.uniform(-0.05, 0.05, BEAMS)
    beam_kind = rng.choice([0, 0, 0, 0, 1, 2], BEAMS).astype(np.uint8)
    depth_mm = 1000.0 * (1.78 + rng.uniform(-0.15, 0.12, (1, HEIGHT, WIDTH)))
    depth_kind = rng.choice([0, 0, 0, 1, 2], depth_mm.shape).astype(np.uint8)
    yaw = radians(-9.0)
    path = by_hand.truth(
        scan_true=ranges_m[np.newaxis],
        scan_kind=beam_kind[np.newaxis],
        depth_true=depth_mm,
        depth_kind=depth_kind,
        T_lidar_camera=None,
        cam_yaw=np.float64(yaw),
    )
    expected = _offsets_by_loop(ranges_m, beam_kind, depth_mm[0], depth_kind[0], yaw)
    assert len(expected) >= 5
    report = evaluate_alignment(_results(by_hand), load_truth(path, lever_arm=ARM))
    assert report.u_true == pytest.approx(np.median(expected))


def _frame(by_hand: Any, error: float | None, overlap: float | None, **more: Any) -> Any:
    u_true = 120.0 - (LEFT_EDGE_DEG - 0.5)
    u = None if error is None else u_true + error
    return {"u": u, "u_alone": u_true + 10.0, "overlap": overlap, "u_cosine": u_true} | more


def test_hits_count_frames_of_enough_overlap_and_none_as_a_miss(by_hand: Any) -> None:
    frames = [
        _frame(by_hand, 1.9, 0.5),
        _frame(by_hand, -1.9, 0.9),
        _frame(by_hand, 2.1, 0.9),
        _frame(by_hand, None, 0.9),
        _frame(by_hand, 0.0, 0.49),
        _frame(by_hand, 0.0, None),
        _frame(by_hand, 0.0, 0.9, scan_stamp_ns=None),
    ]
    report = evaluate_alignment(_results(by_hand, *frames), _round_room(by_hand, 0.0))
    hits = report.to_json()["within_2_samples"]
    assert hits["u"] == {"share": 0.5, "within": 2, "frames": 4}
    assert hits["u_alone"]["share"] == 0.0
    assert hits["u_cosine"]["share"] == 1.0
    assert "u_pearson" not in hits
    assert report.to_json()["frames_with_true_u"] == 6
    pooled = pool_hits([report, report])
    assert (pooled["u"].frames, pooled["u"].within) == (8, 4)


def test_a_frame_without_good_pairs_has_no_true_u(by_hand: Any) -> None:
    truth = _round_room(by_hand, 0.0, scan_kind=np.full((1, BEAMS), 1, np.uint8))
    report = evaluate_alignment(_results(by_hand, _frame(by_hand, 0.0, 1.0)), truth)
    assert np.isnan(report.u_true).all()
    assert report.hits["u"].fraction is None
    assert report.to_json()["u_true_median"] is None


def test_mount_errors_are_estimate_minus_truth(by_hand: Any) -> None:
    truth = load_truth(
        by_hand.truth(
            scan_true=np.full((1, BEAMS), 2.0),
            scan_kind=np.zeros((1, BEAMS), np.uint8),
            depth_true=ROUND_MM,
            depth_kind=np.zeros(ROUND_MM.shape, np.uint8),
            T_lidar_camera=None,
            cam_yaw=np.float64(np.pi - 0.01),
        ),
        lever_arm=LeverArm(
            forward_m=0.1, left_m=0.2, lidar_height_m=0.3, camera_height_m=0.9, pitch_rad=0.05
        ),
    )
    path = _results(
        by_hand,
        yaw_rad=-np.pi + 0.02,
        pitch_rad=0.04,
        forward_m=0.15,
        left_m=None,
        delta_z_m=0.5,
        clock_offset_ms=None,
        clock_offset_ms_sd=None,
    )
    report = evaluate_alignment(path, truth)
    assert report.mount_error == {
        "yaw_rad": pytest.approx(0.03),
        "pitch_rad": pytest.approx(-0.01),
        "forward_m": pytest.approx(0.05),
        "left_m": None,
        "delta_z_m": pytest.approx(-0.1),
    }
    assert report.yaw_error_deg == pytest.approx(degrees(0.03))
    assert report.clock_contains_truth is None


@pytest.mark.parametrize(
    ("offset_ms", "sd_ms", "true_ms", "contains"),
    [
        (30.0, 5.1, 40.0, True),
        (30.0, 4.9, 40.0, False),
        (50.0, 5.1, 40.0, True),
        (30.0, None, 40.0, None),
        (30.0, 5.0, None, None),
    ],
)
def test_the_clock_interval_spans_two_standard_deviations(
    by_hand: Any, offset_ms: float, sd_ms: float | None, true_ms: float | None, contains: Any
) -> None:
    clock = {} if true_ms is None else {"clock_offset_ms": np.float64(true_ms)}
    path = _results(by_hand, clock_offset_ms=offset_ms, clock_offset_ms_sd=sd_ms)
    report = evaluate_alignment(path, _round_room(by_hand, 0.0, **clock))
    assert report.clock_contains_truth is contains


def test_rows_in_another_order_are_the_same_frames(by_hand: Any) -> None:
    rng = np.random.default_rng(0)
    truth = _round_room(
        by_hand,
        0.0,
        depth_true=np.repeat(ROUND_MM, 3, axis=0) * np.array([1.0, 1.04, 0.97]).reshape(3, 1, 1),
        depth_kind=rng.choice([0, 1], (3, HEIGHT, WIDTH)).astype(np.uint8),
    )
    frames = [_frame(by_hand, error, 1.0, stamp_ns=n) for n, error in enumerate((0.0, 3.0, 1.0))]
    forward = evaluate_alignment(_results(by_hand, *frames), truth)
    backward = evaluate_alignment(_results(by_hand, *frames[::-1]), truth)
    assert backward.to_json() == forward.to_json()
    np.testing.assert_array_equal(backward.u_true, forward.u_true[::-1])
