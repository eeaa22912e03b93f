"""The table of odometry errors, and what it says was put in."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fusion_core.exporting.tum_trajectory import write_tum_trajectory
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.trajectory import Trajectory
from fusion_core.simulation.faults import FaultSettings
from fusion_core.simulation.scenes import find_scene, write_scene
from fusion_core.simulation.truth import truth_path
from fusion_core.workflows.evaluate.odometry import odometry, odometry_lines

STAMPS_NS = np.arange(41, dtype=np.int64) * 100_000_000
STATED = {
    "wheel": {"distance_scale": 1.0023, "yaw_drift_rad_per_s": 0.0},
    "lidar": {"sigma_near_m": 0.01, "lost_runs": 3.0},
    "faults": {"slip_s": 3.0, "kidnap_at_s": None},
}


def straight(scale: float = 1.0) -> np.ndarray:
    """10 m straight on."""
    x_m = scale * np.linspace(0.0, 10.0, STAMPS_NS.size)
    return np.stack([x_m, np.zeros(x_m.size), np.zeros(x_m.size)], axis=1)


def folder_and_truth(path: Path, **arrays: Any) -> tuple[Path, Path]:
    """A folder whose wheels make 10.023 m of 10 m, and its truth."""
    wheel = Trajectory.from_planar(STAMPS_NS.copy(), straight(1.0023))
    write_tum_trajectory(path / "odometry_wheel.tum", wheel)
    truth = path / "drive.truth.npz"
    np.savez(truth, scan_stamp=STAMPS_NS, pose=straight(), **arrays)
    return path, truth


def test_the_table_names_what_was_put_in(tmp_path: Path) -> None:
    result = odometry(*folder_and_truth(tmp_path, simulated_errors=np.array(json.dumps(STATED))))
    assert result["put_in"] == STATED
    assert result["tracks"]["wheel"]["straight"]["error"] == pytest.approx(0.0023, abs=1e-6)
    lines = odometry_lines(result)
    assert lines[:3] == [
        "put in, wheel: distance_scale 1.0023, yaw_drift_rad_per_s 0",
        "put in, lidar: sigma_near_m 0.01",
        "put in, faults: slip_s 3, kidnap_at_s None",
    ]
    assert lines[4].split()[:2] == ["wheel", "0.23"]


def test_a_reference_that_states_nothing_is_said_to(tmp_path: Path) -> None:
    folder, truth = folder_and_truth(tmp_path)
    result = odometry(folder, truth)
    assert result["put_in"] is None
    assert odometry_lines(result)[0] == "put in: not stated by the reference"


@pytest.mark.parametrize(
    "stated", ["{", '{"wheel": 3}', "[1]", json.dumps({"wheel": {"x": "y" * (1 << 20)}})]
)
def test_statements_of_another_form_are_refused(tmp_path: Path, stated: str) -> None:
    folder, truth = folder_and_truth(tmp_path, simulated_errors=np.array(stated))
    with pytest.raises(ScanLoomError, match="simulated_errors is not"):
        odometry(folder, truth)


@pytest.mark.parametrize("faults", [{}, {"faults": FaultSettings(slip_s=0.1, slip_factor=3.0)}])
def test_a_simulated_truth_states_the_settings_of_its_scene(
    tmp_path: Path, faults: dict[str, FaultSettings]
) -> None:
    scene = find_scene("arena")
    settings = scene.settings.model_copy(
        update={"duration_s": 0.4, "image_scale": 0.1, "camera_rate_hz": 5.0}
    )
    write_scene("arena", tmp_path / "arena.mcap", settings=settings, **faults)
    stated = json.loads(str(np.load(truth_path(tmp_path / "arena.mcap"))["simulated_errors"]))
    noise = {
        "wheel": scene.odometry_noise,
        "lidar": scene.lidar_noise,
        "camera": scene.depth_noise,
        **faults,
    }
    assert stated == {name: own.model_dump() for name, own in noise.items()}
