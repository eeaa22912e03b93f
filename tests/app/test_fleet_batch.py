"""A batch finds the recordings of a rig whose mount was turned, whose clock is off and whose lens
is dusty, and no other."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from fusion_core.evaluation.fleet_quantities import QUANTITIES, FleetSettings
from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.simulation.depth_camera import DepthNoise
from fusion_core.simulation.faults import FaultSettings
from fusion_core.simulation.recorder import record_run
from fusion_core.simulation.scenes import SceneSettings, SimulatedScene, find_scene, plan_run
from fusion_core.simulation.sensor_mounts import SensorMounts, home_robot
from fusion_core.workflows.batch.fleet_flags import FleetTable
from scanloom.cli import main

RECORDINGS = 15
TURNED, LATE, DUSTY = 3, 6, 9
# Three fifths of the pixels are lost; of more, nothing is left to align.
DUST = DepthNoise(patches=50.0)


def turned_mount() -> SensorMounts:
    """The home robot's, its camera turned by 1 deg."""
    mounts = home_robot()
    (camera,) = mounts.cameras
    yaw_rad = mounts.camera_yaw_rad + np.deg2rad(1.0)
    rotation = rotation_from_yaw_pitch_roll(yaw_rad, 0.0, 0.0) @ R_BODY_OPTICAL
    T_base_optical = make_transform(rotation, camera.T_base_optical[:3, 3])
    return replace(
        mounts,
        cameras=(replace(camera, T_base_optical=T_base_optical),),
        camera_yaw_rad=yaw_rad,
    )


def scene_of(number: int) -> SimulatedScene:
    """One robot in another room each time; nothing tells how its camera is mounted."""
    scene = replace(find_scene("furnished_room"), published_mounts="none")
    changes = {
        TURNED: {"mounts": turned_mount},
        LATE: {"clock_offset_ms": 60.0},
        DUSTY: {"depth_noise": DUST},
    }
    return replace(scene, **changes.get(number, {}))


def write_fleet(folder: Path) -> None:
    for number in range(RECORDINGS):
        settings = SceneSettings(
            seed=100 + number, duration_s=6.0, image_scale=0.5, camera_rate_hz=10.0
        )
        run = plan_run(scene_of(number), settings, FaultSettings())
        record_run(run, folder / f"run_{number:02d}.mcap")


@pytest.mark.slow
def test_the_recordings_that_differ_are_found_and_no_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, output = tmp_path / "data", tmp_path / "out"
    data.mkdir()
    write_fleet(data)
    command = ["batch", str(data), "-o", str(output), "--run", "fuse", "--json"]
    assert main([*command, "--", "--no-maps", "--no-figures"]) == 0
    told = json.loads(capsys.readouterr().out)
    rows = pq.read_table(told["table"]).to_pylist()
    fleet = FleetTable()
    for row in rows:
        fleet.add(row)
    z = fleet.compare(FleetSettings()).z
    with capsys.disabled():
        print("\n" + " ".join(["recording", *(q.name for q in QUANTITIES)]))
        for row, values in zip(rows, z, strict=True):
            print(row["name"], *(f"{value:6.2f}" for value in values), ",".join(row["flags"]))
        for row in rows:
            for reason in row["reasons"]:
                print(row["name"], reason)
    assert {number: row["flags"] for number, row in enumerate(rows) if row["flags"]} == {
        TURNED: ["mount moved"],
        LATE: ["clock drifts"],
        DUSTY: ["lens went blind"],
    }
    report = Path(told["report"]).read_text(encoding="utf-8")
    assert "mount moved" in report
