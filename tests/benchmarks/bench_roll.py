"""The mount of cameras that are rolled, with and without what floor and walls show of it.

    python -m tests.benchmarks.bench_roll [--seeds 8] [--first 1] [--scene furnished_room]
        [--seconds 6]

For each seed a scene is recorded with a camera that is rolled by 1 to 3 degrees to either side and
looks down by up to 15, both drawn, and nothing known of the mount. "level" is the estimate that
leaves the roll out. Angles in degrees, lengths in metres, each error beside the deviation that is
stated for it. The normalised error squared is (error / deviation)^2 over the seeds that call the
parameter observable: its mean is 1 where the deviations are right.
"""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

from fusion_core.alignment.mount import MountEstimate
from fusion_core.alignment.rig_tilt import RigTilt
from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.geometry import rotation_from_yaw_pitch_roll
from fusion_core.model.rig import Mount
from fusion_core.recordings.formats import open_recording
from fusion_core.simulation.faults import FaultSettings
from fusion_core.simulation.recorder import record_run
from fusion_core.simulation.scenes import SimulatedScene, find_scene, plan_run
from fusion_core.simulation.sensor_mounts import SensorMounts
from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.session import FuseOptions, open_session
from fusion_core.workflows.fuse.settings import PRESETS

# Sizes of real cameras' tilts, as far as they were meant to be level in the image.
LEAST_ROLL_DEG, MOST_ROLL_DEG, MOST_PITCH_DEG = 1.0, 3.0, 15.0
DEG = 180.0 / np.pi
SHOWN = {"yaw": (0, DEG), "pitch": (4, DEG), "forward": (2, 1.0), "left": (3, 1.0)}


def turned(mounts: SensorMounts, pitch_rad: float, roll_rad: float) -> SensorMounts:
    """The mounts with their one camera at this pitch and roll."""
    (camera,) = mounts.cameras
    R = rotation_from_yaw_pitch_roll(mounts.camera_yaw_rad, pitch_rad, roll_rad) @ R_BODY_OPTICAL
    T_base_optical = camera.T_base_optical.copy()
    T_base_optical[:3, :3] = R
    return replace(mounts, cameras=(replace(camera, T_base_optical=T_base_optical),))


def record(scene: SimulatedScene, path: Path, seed: int, seconds: float) -> tuple[Mount, float]:
    """Record the scene with a tilted camera; its mount and its roll in radians."""
    rng = np.random.default_rng(seed)
    roll_rad = float(np.deg2rad(rng.uniform(LEAST_ROLL_DEG, MOST_ROLL_DEG)) * rng.choice([-1, 1]))
    pitch_rad = float(np.deg2rad(rng.uniform(0.0, MOST_PITCH_DEG)))
    mounts = turned(scene.mounts(), pitch_rad, roll_rad)
    own = replace(scene, mounts=lambda: mounts, published_mounts="none")
    settings = scene.settings.model_copy(update={"seed": seed, "duration_s": seconds})
    record_run(plan_run(own, settings, FaultSettings()), path)
    forward_m, left_m, delta_z_m = map(float, mounts.T_lidar_camera()[0, :3, 3])
    truth = Mount(
        yaw_rad=mounts.camera_yaw_rad,
        delta_z_m=delta_z_m,
        forward_m=forward_m,
        left_m=left_m,
        pitch_rad=pitch_rad,
    )
    return truth, roll_rad


def estimates(path: Path) -> dict[str, MountEstimate]:
    """The mount of the rig as it is found, and that of the rig as a level one."""
    with open_recording(path) as recording:
        session = open_session(recording, FuseOptions(), PRESETS["default"])
        found = align_recording(session).estimate
        with patch.object(RigTilt, "is_rolled", False):
            level = align_recording(session).estimate
    assert found is not None
    assert level is not None
    return {"level": level, "rolled": found}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--scene", default="furnished_room")
    parser.add_argument("--seconds", type=float, default=6.0)
    asked = parser.parse_args()
    scene = find_scene(asked.scene)
    errors: dict[str, list[tuple[float, float]]] = {}
    for seed in range(asked.first, asked.first + asked.seeds):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "rolled.mcap"
            truth, roll_rad = record(scene, path, seed, asked.seconds)
            found = estimates(path)
        now: dict[str, tuple[float, float]] = {}
        tilt = found["rolled"].tilt
        if tilt is not None:
            roll = np.rad2deg([tilt.roll_rad - roll_rad, tilt.roll_sd_rad])
            now["roll"] = (float(roll[0]), float(roll[1]))
        for name, estimate in found.items():
            off = estimate.mount.vector() - truth.vector()
            for parameter, (index, factor) in SHOWN.items():
                sd = estimate.mount.sd[index]
                if sd is not None:
                    now[f"{parameter} {name}"] = (off[index] * factor, sd * factor)
        for name, value in now.items():
            errors.setdefault(name, []).append(value)
        put_in = f"roll {np.rad2deg(roll_rad):+.2f} pitch {np.rad2deg(truth.pitch_rad):.1f}"
        cells = [f"{name} {error:+.3f}+-{sd:.3f}" for name, (error, sd) in now.items()]
        print(f"seed {seed} {put_in}: {', '.join(cells)}", flush=True)
    for name, values in errors.items():
        error, sd = np.abs(np.array(values)).T
        print(
            f"{name:<15} of {error.size}: error median {np.median(error):.3f} worst "
            f"{error.max():.3f}; normalised squared, mean {np.mean((error / sd) ** 2):.2f}, worst "
            f"{np.max(error / sd):.1f} deviations"
        )


if __name__ == "__main__":
    main()
