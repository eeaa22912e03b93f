"""``calibrate planar`` and ``calibrate intrinsics`` on the command line."""

import json

import numpy as np
import pytest

from scanloom.cli import main

CAMERA = {"fx": 500.0, "fy": 500.0, "cx": 319.5, "cy": 239.5, "width": 640, "height": 480}


@pytest.fixture
def files(tmp_path):
    """Pairs of a LiDAR 30 cm below a camera that looks the same way, and the camera."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(1.0, 4.0, 20), rng.uniform(-0.5, 0.5, 20)
    u, v = 319.5 - 500.0 * y / x, 239.5 + 500.0 * 0.3 / x
    pairs, camera = tmp_path / "pairs.txt", tmp_path / "camera.json"
    np.savetxt(pairs, np.stack([x, y, u + rng.normal(0, 0.2, 20), v], axis=1))
    camera.write_text(json.dumps(CAMERA))
    return pairs, camera


def test_pairs_are_calibrated(files, tmp_path, capsys):
    pairs, camera = files
    args = ["calibrate", "planar", str(pairs), "-o", str(tmp_path / "r.json")]
    assert main([*args, "--intrinsics", str(camera), "--preset", "published", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["T_camera_lidar"][1][3] == pytest.approx(0.3, abs=0.02)
    assert main([*args, "--intrinsics", str(camera)]) == 0
    assert "px on pairs left out" in capsys.readouterr().out


def test_a_failure_is_one_line(files, tmp_path, capsys):
    pairs, _ = files
    args = ["calibrate", "planar", str(pairs), "-o", str(tmp_path / "r.json")]
    assert main(args) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.strip().endswith("as scanloom calibrate intrinsics writes it.")


@pytest.mark.parametrize(
    "args",
    [
        ["planar", "a.bag", "-o", "r.json", "--board", "7x5"],
        ["planar", "a.bag", "-o", "r.json", "--square", "0.1"],
        ["planar", "a.bag", "-o", "r.json", "--seed", "-1"],
    ],
    ids=" ".join,
)
def test_wrong_usage(args, capsys):
    assert main(["calibrate", *args]) == 2
    assert capsys.readouterr().out == ""


def test_intrinsics_need_images(capsys):
    args = ["calibrate", "intrinsics", "-o", "c.yaml", "--board", "7x5", "--square", "0.1"]
    assert main(args) == 2
    assert "needs IMAGES" in capsys.readouterr().err
