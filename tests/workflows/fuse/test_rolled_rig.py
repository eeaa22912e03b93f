"""A camera that is rolled, on a mount of which the recording says nothing."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fusion_core.model.number_text import with_deviation
from fusion_core.model.rig import Mount
from fusion_core.recordings.clouds.formats import read_cloud
from fusion_core.recordings.formats import open_recording
from fusion_core.simulation.scenes import find_scene
from fusion_core.workflows.fuse import export_clouds as exporting
from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.export_clouds import export_clouds
from fusion_core.workflows.fuse.fuse import FuseSummary, fuse
from fusion_core.workflows.fuse.session import FuseOptions, open_session
from fusion_core.workflows.fuse.settings import PRESETS
from scanloom.panels.mount_text import mount_text
from tests.benchmarks.bench_roll import record

SEED = 5


@pytest.fixture(scope="module")
def rolled(tmp_path_factory) -> tuple[Path, Mount, float]:
    path = tmp_path_factory.mktemp("rolled") / "room.mcap"
    return path, *record(find_scene("furnished_room"), path, SEED, 2.0)


@pytest.fixture(scope="module")
def summary(rolled, tmp_path_factory) -> FuseSummary:
    path, _, roll_rad = rolled
    assert abs(np.rad2deg(roll_rad)) > 2.0
    output = tmp_path_factory.mktemp("fused") / "out"
    return fuse(path, output, FuseOptions(figures=False, maps=False))


def test_the_cameras_pose_takes_the_roll(rolled, summary: FuseSummary) -> None:
    path, _, roll_rad = rolled
    document = summary.document
    assert document["roll_rad"] == pytest.approx(roll_rad, abs=np.deg2rad(0.1))
    assert document["roll_rad"] == document["roll_used_rad"]
    assert 0.0 < document["roll_rad_sd"] < np.deg2rad(0.1)
    # The camera's pose in the results is that of the simulator, roll and all.
    with np.load(path.with_suffix(".truth.npz")) as arrays:
        R_true = arrays["T_lidar_camera"].reshape(-1, 4, 4)[0, :3, :3]
    R = np.array(document["cameras"][0]["T_lidar_camera"])[:3, :3]
    assert np.arccos((np.trace(R.T @ R_true) - 1.0) / 2.0) < np.deg2rad(0.4)
    (line,) = (line for line in summary.lines() if " roll " in line)
    degrees = np.rad2deg([document["roll_rad"], document["roll_rad_sd"]])
    assert f"roll {' +- '.join(with_deviation(*degrees))} deg" in line


def test_clouds_have_the_roll(
    rolled, summary: FuseSummary, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The floor's slope, with the roll of the results and as if they had none."""
    path, _, _ = rolled
    slopes_rad = []
    for name in ("clouds", "level"):
        export_clouds(path, summary.output, tmp_path / name, FuseOptions(), voxel_m=0.05)
        points_m = read_cloud(tmp_path / name / "depth.ply").xyz_m.astype(np.float64)
        floor_m = points_m[points_m[:, 2] < np.percentile(points_m[:, 2], 1.0) + 0.1]
        sides = np.column_stack([floor_m[:, :2], np.ones(len(floor_m))])
        slopes_rad.append(np.arctan(np.hypot(*np.linalg.lstsq(sides, floor_m[:, 2])[0][:2])))
        monkeypatch.setattr(exporting, "read_roll_rad", lambda _: 0.0)
    assert slopes_rad[0] < 0.5 * slopes_rad[1]


def test_transforms_that_are_known_keep_their_roll(rolled) -> None:
    """The rig is not rolled by the floor where the recording has a mount, right or wrong."""
    path, truth, _ = rolled
    with open_recording(path) as recording:
        session = open_session(recording, FuseOptions(), PRESETS["default"])
        known = replace(session, rig=replace(session.rig, recorded_mount=truth))
        alignment = align_recording(known)
    assert alignment.on_rig(known) is known
    assert alignment.estimate is not None
    assert alignment.estimate.tilt is None


def test_the_workbench_says_how_far_the_camera_is_rolled(rolled) -> None:
    path, _, roll_rad = rolled
    with open_recording(path) as recording:
        session = open_session(recording, FuseOptions(), PRESETS["default"])
        estimate = align_recording(session).estimate
    assert estimate is not None
    tilt = estimate.tilt
    assert tilt is not None
    seen = (tilt.roll_rad, tilt.roll_sd_rad)
    text = mount_text(
        estimate.mount,
        seen_roll_rad=seen,
        roll_used_rad=estimate.roll_rad,
        is_roll_known=False,
    )
    degrees = np.rad2deg(seen)
    assert degrees[0] == pytest.approx(np.rad2deg(roll_rad), abs=0.05)
    assert f"It is rolled **{' ± '.join(with_deviation(*degrees))}°**" in text
    assert "taken as level" not in text
    assert "taken as level" in mount_text(estimate.mount, seen_roll_rad=(0.0, 1e-3))
    assert "how far it is rolled" in mount_text(estimate.mount, is_roll_known=False)
    assert "rolled" not in mount_text(estimate.mount)
