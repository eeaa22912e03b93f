"""Calibration of a 2D LiDAR and a depth camera without a board, against the truth of rooms.

    python -m tests.benchmarks.bench_planar ROOMS [--only room_4 ...] [--fuse room_4]

ROOMS is a folder of recordings with NAME.truth.npz beside them, which hold ``cam_yaw`` and, where
the mount differs from that of the folder's README, ``cam_pitch``, ``cam_offset``, ``cam_z`` and
``lidar_z``; a recording with /tf_static has its truth from there. Transforms are ignored.

Errors are those of the camera in the LiDAR's frame. The normalised error squared (NEES) is that of
the observable ones of POSE_PARAMETERS with the block of the covariance that they have; over all
rooms its sum lies between the 2.5 % and 97.5 % quantiles of chi^2 where the covariance is honest.
``--fuse`` fuses rooms with the file of the result as --extrinsics and without, and prints what
``evaluate noise`` and ``evaluate repair`` say of both; of several rooms also the mean difference
with its standard error. One room tells little of a difference: a mount that is turned by 0.01
degrees or moved by a millimetre catches another burr or two of some 200, and moves medians of
repairs by several percent. Another height fills other holes of the depth images: errors are
compared at the samples that both runs repair, too, by the mean logarithm of their ratio with its
standard error over frames.
"""

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from fusion_core.calibration.pose_error import pose_error
from fusion_core.evaluation.truth import LeverArm, load_truth
from fusion_core.exporting.extrinsics_files import write_extrinsics
from fusion_core.model.conventions import R_BODY_OPTICAL, FloatArray
from fusion_core.model.extrinsics import POSE_PARAMETERS, ExtrinsicsEstimate
from fusion_core.model.geometry import (
    invert_transform,
    make_transform,
    rotation_from_yaw_pitch_roll,
)
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.calibrate.natural import calibrate_without_board
from fusion_core.workflows.evaluate import evaluate
from fusion_core.workflows.fuse.camera_rig import build_camera_rig
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions
from fusion_core.workflows.fuse.settings import PRESETS
from tests.benchmarks.bench_mount_uncertainty import README_MOUNT
from tests.benchmarks.paired_repairs import pair_repairs

ROOMS = ("room_1", *(f"room_{number}" for number in range(3, 10)))
# Room 1 shares room 3's mount: the covariance is judged on the others.
JUDGED = ROOMS[1:]
MEASURES = (
    "xi",
    "eta",
    "ln(median LiDAR repair)",
    "ln(median depth repair)",
    "depth repairs behind the surface",
)


def true_pose(folder: Path, room: str) -> FloatArray:
    """T_camera_lidar of a room's only camera."""
    with open_recording(folder / room) as recording:
        streams = choose_streams(recording)
        if streams.tf_static is not None:
            rig = build_camera_rig(recording, streams, PRESETS["default"].sampling)
            assert rig.recorded_mount is not None
            T_lidar_camera = rig.recorded_mount.T_lidar_rig @ rig.cameras[0].T_rig_camera
            return invert_transform(T_lidar_camera)
    truth: dict[str, Any] = {**README_MOUNT, **np.load(folder / f"{room}.truth.npz")}
    forward_m, left_m = np.asarray(truth["cam_offset"])
    return invert_transform(
        make_transform(
            rotation_from_yaw_pitch_roll(float(truth["cam_yaw"]), float(truth["cam_pitch"]), 0.0)
            @ R_BODY_OPTICAL,
            np.array([forward_m, left_m, float(truth["cam_z"]) - float(truth["lidar_z"])]),
        )
    )


def mount_of(T_camera_lidar: FloatArray) -> FloatArray:
    """(6,) yaw, pitch, roll (deg), forward, left, up (m) of the camera in the LiDAR's frame."""
    T = invert_transform(T_camera_lidar)
    R = T[:3, :3] @ R_BODY_OPTICAL.T
    angles = [
        np.arctan2(R[1, 0], R[0, 0]),
        -np.arcsin(R[2, 0]),
        np.arctan2(R[2, 1], R[2, 2]),
    ]
    return np.concatenate([np.rad2deg(angles), T[:3, 3]])


@dataclass(frozen=True)
class Result:
    room: str
    estimate: ExtrinsicsEstimate
    T_true: FloatArray
    seconds: float

    @property
    def observable(self) -> list[int]:
        return [
            index
            for index, name in enumerate(POSE_PARAMETERS)
            if name not in self.estimate.unobservable
        ]

    @property
    def nees(self) -> float:
        known = self.observable
        error = pose_error(self.T_true, self.estimate.T_camera_lidar)[known]
        covariance = self.estimate.covariance[np.ix_(known, known)]
        return float(error @ np.linalg.solve(covariance, error))

    def line(self) -> str:
        errors = mount_of(self.T_true) - mount_of(self.estimate.T_camera_lidar)
        basin = self.estimate.basin
        return (
            f"{self.room}  yaw {errors[0]:+.3f} pitch {errors[1]:+.3f} roll {errors[2]:+.3f} deg  "
            f"forward {1e3 * errors[3]:+5.1f} left {1e3 * errors[4]:+5.1f} "
            f"up {1e3 * errors[5]:+6.1f} mm  NEES {self.nees:5.2f} of {len(self.observable)}  "
            f"basin {'-' if basin is None else f'{basin:.0%}'}  {self.seconds:4.1f} s  "
            f"not observable: {', '.join(self.estimate.unobservable) or 'nothing'}"
        )


def calibrate(folder: Path, room: str) -> Result:
    start_s = time.perf_counter()
    with open_recording(folder / room) as recording:
        estimate = calibrate_without_board(recording, ignore_transforms=True)
    seconds = time.perf_counter() - start_s
    return Result(room, estimate, true_pose(folder, room), seconds)


def compare_fused(folder: Path, result: Result) -> FloatArray:
    """Print xi, eta and the errors of repairs, with the result as extrinsics and without; (7,) the
    differences by MEASURES and of both sensors' repairs that both runs make, those of repairs of
    their logarithms."""
    truth_file = folder / f"{result.room}.truth.npz"
    T = invert_transform(result.T_true)
    arm = (float(T[0, 3]), float(T[1, 3]), float(T[2, 3]))
    pitch_rad = float(np.deg2rad(mount_of(result.T_true)[1]))
    with tempfile.TemporaryDirectory() as work:
        file = Path(work) / "extrinsics.json"
        write_extrinsics(file, result.estimate, camera_frame="camera", lidar_frame="lidar")
        measures = []
        for name, extrinsics in (("without", None), ("with", file)):
            output = Path(work) / name
            options = FuseOptions(figures=False, maps=False, extrinsics_file=extrinsics)
            fuse(folder / result.room, output, options)
            print(f"{result.room} fused {name} --extrinsics")
            measures.append(print_measures(output, truth_file, arm, pitch_rad))
        truth = load_truth(
            truth_file,
            lever_arm=LeverArm(
                forward_m=arm[0],
                left_m=arm[1],
                lidar_height_m=0.0,
                camera_height_m=arm[2],
                pitch_rad=pitch_rad,
            ),
        )
        paired = pair_repairs(Path(work) / "without", Path(work) / "with", truth)
    for sensor, repairs in paired.items():
        print(f"  {sensor} repairs, {repairs.line()}")
    without, with_extrinsics = measures
    log_ratios = [paired[sensor].log_ratio for sensor in ("lidar", "depth")]
    return np.append(with_extrinsics - without, log_ratios)


def print_differences(differences: FloatArray) -> None:
    """Of (rooms, 7) differences the mean and its standard error."""
    rooms = len(differences)
    # Where the curves have no repair in common, that is nan.
    known = np.isfinite(differences).sum(axis=0)
    mean = np.nanmean(differences, axis=0)
    error = np.nanstd(differences, axis=0, ddof=1) / np.sqrt(known)
    print(f"with --extrinsics against without, mean of {rooms} rooms +- its standard error:")
    both = "ln(LiDAR repair that both make)", "ln(depth repair that both make)"
    for name, value, sd in zip((*MEASURES, *both), mean, error, strict=True):
        print(f"  {name} {value:+.4f} +- {sd:.4f}")


def print_measures(
    output: Path, truth_file: Path, arm_m: tuple[float, float, float], pitch_rad: float
) -> FloatArray:
    """(5,) by MEASURES."""
    noise = evaluate.noise(output, truth_file, lever_arm_m=arm_m, pitch_rad=pitch_rad)
    repair = evaluate.repair(output, truth_file, lever_arm_m=arm_m, pitch_rad=pitch_rad)
    print(f"  xi {noise['xi']:.4f}  eta {noise['eta']:.4f}")
    for sensor in ("lidar", "depth"):
        own = repair[sensor]["by_source"]["all"]
        print(
            f"  {sensor} repairs: {own['count']}, median {1e3 * own['median_m']:.2f} mm, "
            f"p90 {1e3 * own['p90_m']:.1f} mm, rms {own['rms_m']:.3f} m, behind the surface "
            f"{own['behind_surface']:.2%}; holes filled {repair[sensor]['holes_filled']:.2%}"
        )
    of_lidar, of_depth = (repair[sensor]["by_source"]["all"] for sensor in ("lidar", "depth"))
    return np.array(
        [
            noise["xi"],
            noise["eta"],
            np.log(of_lidar["median_m"]),
            np.log(of_depth["median_m"]),
            of_depth["behind_surface"],
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rooms", type=Path)
    parser.add_argument("--only", nargs="*", default=ROOMS)
    parser.add_argument("--fuse", nargs="*", default=())
    arguments = parser.parse_args()
    judged, differences = [], []
    for room in arguments.only:
        result = calibrate(arguments.rooms, room)
        print(result.line(), flush=True)
        if room in JUDGED:
            judged.append(result)
        if room in arguments.fuse:
            differences.append(compare_fused(arguments.rooms, result))
    if len(differences) > 1:
        print_differences(np.array(differences))
    if judged:
        total = sum(result.nees for result in judged)
        degrees = sum(len(result.observable) for result in judged)
        low, high = chi2.ppf([0.025, 0.975], degrees)
        print(
            f"NEES over {len(judged)} rooms: {total:.1f} for {degrees} degrees of freedom, "
            f"95 % interval {low:.1f} to {high:.1f}"
        )


if __name__ == "__main__":
    main()
