"""``scanloom calibrate camera`` on files: results, figures, and one clear line for bad input."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from fusion_core.calibration.pose_error import pose_error
from fusion_core.exporting.clouds import write_cloud
from fusion_core.exporting.extrinsics_files import intrinsics_document
from fusion_core.model.conventions import FloatArray
from fusion_core.recordings.calibration_files.estimate import read_estimate
from fusion_core.recordings.clouds.formats import read_cloud
from scanloom.cli import main
from tests.calibration.textured_room import Scene, small_scene


@dataclass(frozen=True)
class Files:
    cloud: Path
    image: Path
    intrinsics: Path
    scene: Scene

    def run(self, output: Path, *more: str, cloud: Path | None = None) -> int:
        return main(
            [
                *("calibrate", "camera", str(cloud or self.cloud), str(self.image)),
                *("-o", str(output), "--intrinsics", str(self.intrinsics), *more),
            ]
        )


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    folder = tmp_path_factory.mktemp("camera")
    scene = small_scene()
    found = Files(folder / "cloud.ply", folder / "image.png", folder / "camera.json", scene)
    write_cloud(found.cloud, scene.cloud.xyz_m.astype(np.float64), intensity=scene.cloud.intensity)
    cv2.imwrite(str(found.image), scene.grey)
    found.intrinsics.write_text(json.dumps(intrinsics_document(scene.camera)))
    return found


def write_guess(path: Path, T_camera_lidar: FloatArray) -> Path:
    path.write_text(json.dumps({"T_camera_lidar": T_camera_lidar.tolist()}))
    return path


def test_a_cloud_and_an_image_give_a_result_with_its_figures(
    files: Files, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "result.json"
    assert files.run(output, "--json", "--cloud", str(tmp_path / "colored.ply")) == 0
    printed = json.loads(capsys.readouterr().out)
    estimate = read_estimate(output)
    np.testing.assert_allclose(printed["T_camera_lidar"], estimate.T_camera_lidar, atol=1e-12)
    error = pose_error(files.scene.T_camera_lidar, estimate.T_camera_lidar)
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.1
    assert estimate.reprojection_rms_px is not None
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "colored.ply",
        "result.json",
        "result.tf.mcap",
        "result.urdf",
        "result.yaml",
        "result_matches.png",
        "result_overlay.png",
        "result_patches.png",
        "result_reprojection.png",
    ]
    curve = printed["reprojection_curve"]["filtered"]
    assert len(curve["pairs"]) == len(curve["error_px"]) > 8
    assert len(read_cloud(tmp_path / "colored.ply").xyz_m) == printed["colored_points"]


def test_the_true_guess_is_kept_and_printed(
    files: Files, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    guess = write_guess(tmp_path / "guess.json", files.scene.T_camera_lidar)
    assert files.run(tmp_path / "result.toml", "--guess", str(guess)) == 0
    assert "The guess is kept" in capsys.readouterr().out
    kept = read_estimate(tmp_path / "result.toml")
    assert not kept.improved
    np.testing.assert_allclose(kept.T_camera_lidar, files.scene.T_camera_lidar, atol=1e-12)


def few_points(scale: float = 1.0) -> FloatArray:
    rng = np.random.default_rng(0)
    return scale * rng.uniform([2.0, -1.0, -1.0], [4.0, 1.0, 1.0], (3000, 3))


BAD_CLOUDS: dict[str, tuple[Callable[[Path], None], str]] = {
    "without intensity": (lambda path: write_cloud(path, few_points()), "has no intensities"),
    "constant intensity": (
        lambda path: write_cloud(path, few_points(), intensity=np.full(3000, 12.0, np.float32)),
        "all points have the intensity 12",
    ),
    "intensity NaN": (
        lambda path: write_cloud(path, few_points(), intensity=np.full(3000, np.nan, np.float32)),
        "only 0 of 3000 points are finite",
    ),
    "millimetres": (
        lambda path: write_cloud(path, few_points(1000.0), intensity=few_points()[:, 0]),
        "Lengths are in metres",
    ),
}


@pytest.mark.parametrize("kind", BAD_CLOUDS)
def test_a_bad_cloud_is_one_clear_line(
    files: Files, tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write, message = BAD_CLOUDS[kind]
    cloud = tmp_path / "bad.ply"
    write(cloud)
    assert files.run(tmp_path / "result.json", cloud=cloud) == 1
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith(f"{cloud}: ")
    assert message in line
    assert not (tmp_path / "result.json").exists()


def test_an_image_of_another_size_is_one_clear_line(
    files: Files, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), files.scene.grey[::2, ::2])
    arguments = ["calibrate", "camera", str(files.cloud), str(small)]
    more = ["-o", str(tmp_path / "result.json"), "--intrinsics", str(files.intrinsics)]
    assert main([*arguments, *more]) == 1
    line = capsys.readouterr().err.splitlines()[-1]
    assert "512 x 384" in line
    assert "256 x 192" in line


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--settings", "SETTINGS"], "needs an initial guess"),
        (["--cloud", "colored.txt"], "not a point cloud format"),
    ],
)
def test_options_that_do_not_fit_are_one_clear_line(
    files: Files,
    tmp_path: Path,
    more: list[str],
    message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    settings = tmp_path / "settings.toml"
    settings.write_text('[calibration]\nmethod = "information"\n')
    given = [str(settings) if word == "SETTINGS" else word for word in more]
    assert files.run(tmp_path / "result.json", *given) == 1
    assert message in capsys.readouterr().err.splitlines()[-1]


def test_without_intrinsics_it_says_where_they_come_from(
    files: Files, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["calibrate", "camera", str(files.cloud), str(files.image)]
    assert main([*arguments, "-o", str(tmp_path / "result.json")]) == 1
    assert "--intrinsics FILE" in capsys.readouterr().err.splitlines()[-1]


def test_an_input_is_never_written_over(
    files: Files, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = files.cloud.read_bytes()
    assert files.run(tmp_path / "result.json", "--cloud", str(files.cloud)) == 1
    assert files.run(files.intrinsics) == 1
    assert "is read as the input" in capsys.readouterr().err
    assert files.cloud.read_bytes() == before


def test_the_presets_differ_and_a_settings_file_is_read(
    files: Files, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = tmp_path / "settings.toml"
    settings.write_text("[pose]\npairs_min = 5000\n")
    assert files.run(tmp_path / "result.json", "--settings", str(settings)) == 1
    assert "at least 5000 are needed" in capsys.readouterr().err
