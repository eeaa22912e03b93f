"""Extrinsics of the simulated rig of Song 2022 over seeds: errors of the pose, reprojection of
held-out pairs, whether the covariance is honest, and the time; beside it a calibration by boards.

    python -m tests.benchmarks.bench_extrinsics [--seeds 20] [--preset default published board]
        [--true-mounting] [--figure CURVE.png]

Each seed is a room, a mounting and a camera of its own. The cloud is put together by the mounting
that self-calibration finds (or the true one). ``board`` is Park 2014 as Song's Table 5 has it: six
poses of a checkerboard, its corners in the image and in the cloud, and PnP.
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from fusion_core.calibration.features.camera_calibration import calibrate_by_features
from fusion_core.calibration.features.pose_fit import (
    fit_pose,
    reprojection_residuals,
)
from fusion_core.calibration.features.reprojection import ReprojectionCurve
from fusion_core.calibration.pose_error import pose_error
from fusion_core.calibration.reprojection_rms import reprojection_rms
from fusion_core.calibration.turning.self_calibration import self_calibrate
from fusion_core.exporting.figures_camera_calibration import write_reprojection_curve
from fusion_core.lens.projection import project_points
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.geometry import invert_transform, transform_points
from fusion_core.model.sensors import PointCloud
from fusion_core.simulation.turning_rig import (
    TurningRigData,
    TurningRigSettings,
    simulate_turning_rig,
)
from fusion_core.workflows.calibrate.camera_settings import PRESETS
from fusion_core.workflows.calibrate.lidar_settings import PRESETS as LIDAR_PRESETS
from tests.benchmarks.bench_self_calibration import read_turn

BOARD_POSES, BOARD_COLUMNS, BOARD_ROWS, SQUARE_M = 6, 7, 5, 0.105


@dataclass(frozen=True)
class Row:
    """``rotation_deg``, ``place_mm``: errors. ``true_px``: reprojection of the pairs' points by
    the estimate, against their reprojection by the truth."""

    seed: int
    rotation_deg: float
    place_mm: float
    held_out_px: float
    used_px: float
    nees: float
    pairs: int
    seconds: float
    cpu_seconds: float
    curve: ReprojectionCurve | None


def cloud_of(data: TurningRigData, seed: int, *, true_mounting: bool) -> PointCloud:
    T_axis_lidar = None
    if not true_mounting:
        s = LIDAR_PRESETS["default"]
        turn = read_turn(data, seed)
        T_axis_lidar = self_calibrate(turn, s.self_calibration, s.frames, s.planes).T_axis_lidar
    points_m, intensity = data.cloud_in_rig(T_axis_lidar)
    return PointCloud(
        stamp_ns=0,
        received_ns=None,
        frame_id="rig",
        xyz_m=points_m.astype(np.float32),
        intensity=intensity.astype(np.float32),
    )


def by_features(data: TurningRigData, cloud: PointCloud, seed: int, preset: str) -> Row:
    settings = PRESETS["published" if preset == "published" else "default"]
    grey = np.asarray(cv2.cvtColor(data.rgb, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    started, started_cpu = time.perf_counter(), time.process_time()
    calibration = calibrate_by_features(cloud, grey, data.intrinsics, settings)
    seconds, cpu = time.perf_counter() - started, time.process_time() - started_cpu
    estimate = calibration.estimate
    error = pose_error(data.T_camera_lidar, estimate.T_camera_lidar)
    return Row(
        seed=seed,
        rotation_deg=float(np.rad2deg(np.linalg.norm(error[:3]))),
        place_mm=1e3 * float(np.linalg.norm(error[3:])),
        held_out_px=estimate.reprojection_rms_px or np.nan,
        used_px=estimate.reprojection_rms_used_px or np.nan,
        nees=float(error @ np.linalg.solve(estimate.covariance, error)),
        pairs=int(calibration.pairs.accepted.sum()),
        seconds=seconds,
        cpu_seconds=cpu,
        curve=calibration.curve,
    )


def by_boards(data: TurningRigData, seed: int) -> Row:
    """Six boards before the camera, seen by the LiDAR as points of a turn (1 cm, 0.1° apart)."""
    rng = np.random.default_rng((seed, 7))
    T_lidar_camera = invert_transform(data.T_camera_lidar)
    size = np.array([BOARD_COLUMNS + 1, BOARD_ROWS + 1]) * SQUARE_M
    inner = np.stack(
        np.meshgrid(np.arange(1, BOARD_COLUMNS + 1), np.arange(1, BOARD_ROWS + 1)), axis=-1
    ).reshape(-1, 2)
    corners = inner * SQUARE_M - size / 2
    points, pixels, groups = [], [], []
    while len(groups) < BOARD_POSES:
        turned = Rotation.from_euler("zyx", rng.uniform(-0.5, 0.5, 3)).as_matrix()
        centre = rng.uniform([-0.9, -0.6, 1.8], [0.9, 0.6, 3.0])
        on_board = np.concatenate([corners, np.zeros((len(corners), 1))], axis=1)
        seen = project_points(on_board @ turned.T + centre, data.intrinsics)
        if not ((seen > 10) & (seen < (1270, 950))).all():
            continue
        found = corners_in_cloud(rng, turned, centre, size, T_lidar_camera)
        points.append(transform_points(found, on_board))
        # What cv2.cornerSubPix has on a sharp image.
        pixels.append(seen + rng.normal(scale=0.1, size=seen.shape))
        groups.append(len(groups))
    all_points, all_pixels = np.concatenate(points), np.concatenate(pixels)
    _, rotation, place = cv2.solvePnP(
        all_points,
        all_pixels,
        data.intrinsics.matrix,
        None,
        flags=cv2.SOLVEPNP_SQPNP,
    )
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = cv2.Rodrigues(rotation)[0], place.ravel()
    fit = fit_pose(all_points, all_pixels, data.intrinsics, start, scale_px=None)
    held_out = []
    for k in range(BOARD_POSES):
        rest = [j for j in range(BOARD_POSES) if j != k]
        other = fit_pose(
            np.concatenate([points[j] for j in rest]),
            np.concatenate([pixels[j] for j in rest]),
            data.intrinsics,
            fit.T_camera_lidar,
            scale_px=None,
        )
        held_out.append(
            reprojection_residuals(other.T_camera_lidar, points[k], pixels[k], data.intrinsics)
        )
    error = pose_error(data.T_camera_lidar, fit.T_camera_lidar)
    return Row(
        seed=seed,
        rotation_deg=float(np.rad2deg(np.linalg.norm(error[:3]))),
        place_mm=1e3 * float(np.linalg.norm(error[3:])),
        held_out_px=reprojection_rms(np.concatenate(held_out)),
        used_px=reprojection_rms(fit.residuals_px),
        nees=np.nan,
        pairs=len(all_points),
        seconds=0.0,
        cpu_seconds=0.0,
        curve=None,
    )


def corners_in_cloud(
    rng: np.random.Generator,
    turned: FloatArray,
    centre: FloatArray,
    size: FloatArray,
    T_lidar_camera: FloatArray,
) -> FloatArray:
    """T_lidar_board from the LiDAR's points on a board: plane by SVD, then the rectangle of known
    shape around the points in the plane (Park 2014 fits the sides)."""
    T_lidar_board = T_lidar_camera @ np.block(
        [[turned, centre[:, np.newaxis]], [np.zeros((1, 3)), np.ones((1, 1))]]
    )
    distance = float(np.linalg.norm(T_lidar_board[:3, 3]))
    spacing = np.deg2rad(0.1) * distance
    count = round(float(np.prod(size)) / spacing**2)
    flat = rng.uniform(-0.5, 0.5, (count, 2)) * size
    hit = transform_points(T_lidar_board, np.concatenate([flat, np.zeros((count, 1))], axis=1))
    ranges = np.linalg.norm(hit, axis=1, keepdims=True)
    hit = hit * (1.0 + rng.normal(scale=0.01, size=(count, 1)) / ranges)
    middle = hit.mean(axis=0)
    _, _, axes = np.linalg.svd(hit - middle, full_matrices=False)
    in_plane = (hit - middle) @ axes[:2].T
    box = cv2.minAreaRect(in_plane.astype(np.float32))
    corners = cv2.boxPoints(box).astype(np.float64)
    sides = np.roll(corners, -1, axis=0) - corners
    longest = sides[int(np.argmax(np.linalg.norm(sides, axis=1)))]
    x = np.append(longest / np.linalg.norm(longest), 0.0) @ np.vstack([axes[:2], axes[2:]])
    x = x if x @ T_lidar_board[:3, 0] > 0 else -x
    z = axes[2] if axes[2] @ T_lidar_board[:3, 2] > 0 else -axes[2]
    result = np.eye(4)
    result[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    result[:3, 3] = middle + np.array(box[0]) @ axes[:2]
    return result


def report(name: str, rows: list[Row], failures: list[str]) -> None:
    print(f"\n{name}: {len(rows)} seeds, {len(failures)} refused")
    for failure in failures:
        print(f"  refused: {failure}")
    if not rows:
        return
    for what, values, unit in (
        ("rotation error", [row.rotation_deg for row in rows], "deg"),
        ("position error", [row.place_mm for row in rows], "mm"),
        ("held-out error (18)", [row.held_out_px for row in rows], "px"),
        ("used pairs' error (18)", [row.used_px for row in rows], "px"),
        ("time", [row.seconds for row in rows], "s"),
        ("processor time", [row.cpu_seconds for row in rows], "s"),
    ):
        print(f"  {what:<24} median {np.median(values):.4f}  max {np.max(values):.4f} {unit}")
    nees = np.array([row.nees for row in rows])
    if np.isfinite(nees).all():
        low, high = chi2.ppf([0.025, 0.975], 6 * len(rows)) / len(rows)
        print(
            f"  NEES mean {nees.mean():.2f}, 95 % interval of 6 is [{low:.2f}, {high:.2f}], "
            f"max {nees.max():.1f}"
        )
    curve = rows[0].curve
    if curve is not None:
        print(f"  Fig. 11, seed {rows[0].seed}: pairs, px before the filter, px after it")
        for line in zip(curve.pairs, curve.unfiltered_px, curve.filtered_px, strict=True):
            print("    {:5d}  {:8.3f}  {:8.3f}".format(*line))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument(
        "--preset", nargs="+", default=["default", "published", "board"], metavar="NAME"
    )
    parser.add_argument("--true-mounting", action="store_true")
    parser.add_argument("--figure", type=Path)
    given = parser.parse_args()
    rows: dict[str, list[Row]] = {preset: [] for preset in given.preset}
    failures: dict[str, list[str]] = {preset: [] for preset in given.preset}
    for seed in range(given.first, given.first + given.seeds):
        data = simulate_turning_rig(TurningRigSettings(), seed)
        cloud = None
        for preset in given.preset:
            try:
                if preset == "board":
                    row = by_boards(data, seed)
                else:
                    cloud = cloud or cloud_of(data, seed, true_mounting=given.true_mounting)
                    row = by_features(data, cloud, seed, preset)
            except CalibrationFailed as error:
                failures[preset].append(f"seed {seed}: {error}")
                continue
            rows[preset].append(row)
            print(
                f"{preset:<9} seed {seed:>2}  {row.rotation_deg:.4f} deg  {row.place_mm:.2f} mm  "
                f"held out {row.held_out_px:.2f} px  used {row.used_px:.2f} px  "
                f"NEES {row.nees:.1f}  {row.pairs} pairs  {row.seconds:.1f} s "
                f"(processor {row.cpu_seconds:.1f} s)",
                flush=True,
            )
    for preset in given.preset:
        report(preset, rows[preset], failures[preset])
    if given.figure is not None:
        first = next(row for row in rows[given.preset[0]] if row.curve is not None)
        assert first.curve is not None
        write_reprojection_curve(
            given.figure,
            f"simulated rig, seed {first.seed}, preset {given.preset[0]}",
            pairs=first.curve.pairs,
            unfiltered_px=first.curve.unfiltered_px,
            filtered_px=first.curve.filtered_px,
            held_out_px=first.held_out_px,
        )


if __name__ == "__main__":
    main()
