"""Self-calibration of the simulated rig of Song 2022 over seeds: errors of θ, β, Δx, Δy, the
repeatability E_r and E_t (19), the room's dimensions, and whether the covariance is honest.

Run with:  python -m tests.benchmarks.bench_self_calibration [--seeds 20] [--sigma 0.01 0.03]
           [--preset default published]
"""

import argparse
import time
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from fusion_core.calibration.turning.axis_angles import make_axis_angles
from fusion_core.calibration.turning.self_calibration import SelfCalibration, self_calibrate
from fusion_core.calibration.turning.turn import Turn
from fusion_core.model.conventions import NS_PER_S
from fusion_core.simulation.spinning_lidar import SpinningLidarSettings
from fusion_core.simulation.turning_rig import (
    T_AXIS_LIDAR_NOMINAL,
    TurningRigData,
    TurningRigSettings,
    simulate_turning_rig,
)
from fusion_core.workflows.calibrate.lidar_settings import PRESETS

# As many points of each scan as `calibrate lidar` reads.
_POINTS_OF_A_SCAN = 3300
_UNITS = np.array([180.0 / np.pi, 180.0 / np.pi, 1e3, 1e3])


@dataclass(frozen=True)
class Row:
    error: np.ndarray
    nees: float
    E_r_deg: float
    E_t_mm: float
    room_mm: np.ndarray
    seconds: float


def read_turn(data: TurningRigData, seed: int) -> Turn:
    """The turn as it is read of a recording: by the encoder's angles, a part of each scan."""
    rng = np.random.default_rng(seed)
    axis = make_axis_angles(data.joint_stamps_ns, data.joint_angles_rad)
    points, angles, scans = [], [], []
    for index, scan in enumerate(data.scans):
        chosen = np.sort(rng.choice(len(scan.points_m), _POINTS_OF_A_SCAN, replace=False))
        offsets_ns = np.rint(scan.offsets_s[chosen].astype(np.float64) * NS_PER_S).astype(np.int64)
        points.append(scan.points_m[chosen].astype(np.float64))
        angles.append(axis.at(scan.stamp_ns + offsets_ns))
        scans.append(np.full(chosen.size, index))
    return Turn(
        points_in_lidar_m=np.concatenate(points),
        axis_angles_rad=np.concatenate(angles),
        scan_indices=np.concatenate(scans),
        T_axis_lidar_nominal=T_AXIS_LIDAR_NOMINAL,
    )


def room_errors_mm(result: SelfCalibration, data: TurningRigData) -> np.ndarray:
    """Length, width and height of the room by the planes of the result, less the true ones.

    The planes are those of the estimate; which of them is a wall comes from the true pose.
    """
    normals = np.stack([plane.normal for plane in result.planes]) @ data.T_room_rig[:3, :3].T
    offsets = np.array([plane.offset_m for plane in result.planes])
    origin = data.T_room_rig[:3, 3]
    errors = np.full(3, np.nan)
    for axis, size in enumerate(data.room_size_m):
        sides = []
        for sign, distance in ((-1.0, origin[axis]), (1.0, size - origin[axis])):
            fits = (sign * normals[:, axis] > 0.995) & (np.abs(offsets - distance) < 0.1)
            if fits.any():
                sides.append(offsets[fits][np.abs(offsets[fits] - distance).argmin()])
        if len(sides) == 2:
            errors[axis] = 1e3 * (sum(sides) - size)
    return errors


def run(seed: int, sigma_m: float, presets: list[str]) -> dict[str, Row]:
    lidar = SpinningLidarSettings(range_sigma_m=sigma_m)
    data = simulate_turning_rig(TurningRigSettings(lidar=lidar), seed)
    truth = np.array([data.theta_rad, data.beta_rad, *data.delta_m])
    turn = read_turn(data, seed)
    rows = {}
    for preset in presets:
        settings = PRESETS[preset]
        started = time.perf_counter()
        result = self_calibrate(turn, settings.self_calibration, settings.frames, settings.planes)
        error = result.parameters - truth
        rows[preset] = Row(
            error=error * _UNITS,
            nees=float(error @ np.linalg.solve(result.covariance, error)),
            E_r_deg=float(np.rad2deg(result.E_r_rad)),
            E_t_mm=1e3 * result.E_t_m,
            room_mm=room_errors_mm(result, data),
            seconds=time.perf_counter() - started,
        )
    return rows


def report(rows: list[Row], sigma_m: float, preset: str) -> None:
    errors = np.abs(np.stack([row.error for row in rows]))
    room = np.abs(np.stack([row.room_mm for row in rows]))
    nees = np.array([row.nees for row in rows])
    low, high = chi2.ppf([0.025, 0.975], 4 * len(rows)) / len(rows)
    print(f"\n{preset}, sigma {100 * sigma_m:g} cm, {len(rows)} seeds")
    for index, (name, unit) in enumerate((("θ", "deg"), ("β", "deg"), ("Δx", "mm"), ("Δy", "mm"))):
        _print_spread(f"|error of {name}|", errors[:, index], unit)
    _print_spread("E_r (Song 0.0524)", np.array([row.E_r_deg for row in rows]), "deg")
    _print_spread("E_t (Song 0.35)", np.array([row.E_t_mm for row in rows]), "mm")
    for index, name in enumerate(("length", "width", "height")):
        _print_spread(f"|error of the room's {name}|", room[:, index], "mm")
    _print_spread("time", np.array([row.seconds for row in rows]), "s")
    print(
        f"  NEES: mean {nees.mean():.2f}, max {nees.max():.1f}; of 4, 95 % [{low:.2f}, {high:.2f}]"
    )


def _print_spread(name: str, values: np.ndarray, unit: str) -> None:
    known = values[np.isfinite(values)]
    missing = f", not measured {values.size - known.size}" if known.size < values.size else ""
    print(f"  {name:<28} median {np.median(known):.4f}, max {known.max():.4f} {unit}{missing}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--sigma", type=float, nargs="+", default=[0.01, 0.03])
    parser.add_argument("--preset", nargs="+", default=["default", "published"])
    given = parser.parse_args()
    for sigma_m in given.sigma:
        rows: dict[str, list[Row]] = {preset: [] for preset in given.preset}
        for seed in range(given.first, given.first + given.seeds):
            for preset, row in run(seed, sigma_m, given.preset).items():
                rows[preset].append(row)
                error = row.error.round(4)
                print(f"{preset} seed {seed}: {error}, NEES {row.nees:.2f}", flush=True)
        for preset in given.preset:
            report(rows[preset], sigma_m, preset)


if __name__ == "__main__":
    main()
