"""TUM RGB-D folders: image lists, damaged ones, and the benchmark's own cameras."""

import os
import shutil
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import open3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.decimal_time import ns_from_decimal_seconds
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.topics import choose_streams

DEPTH, COLOR = "/camera/depth/image_raw", "/camera/color/image_raw"
INFO, TRUTH = "/camera/depth/camera_info", "/camera/ground_truth"


def counts(path: Path) -> dict[str, int]:
    with open_recording(path) as recording:
        return {topic.name: topic.count for topic in recording.topics}


def warnings(path: Path) -> list[str]:
    with open_recording(path) as recording:
        return recording.warnings


@pytest.fixture
def folder(build: Callable[[str], Any]) -> Path:
    """Five depth and colour images, twelve poses, and a calibration.txt."""
    return Path(build("TUM RGB-D").path)


def add_line(file: Path, line: str) -> None:
    file.write_text(file.read_text() + line + "\n")


@given(st.integers(0, 2**63 - 1))
def test_decimal_seconds_are_exact(ns: int) -> None:
    assert ns_from_decimal_seconds(f"{ns // 10**9}.{ns % 10**9:09d}") == ns
    assert ns_from_decimal_seconds(str(Decimal(ns).scaleb(-9))) == ns


@pytest.mark.parametrize(
    "text", ["", "-1", "nan", "inf", "1e999999999", "9223372036.854775808", "1" * 41, "1.2.3"]
)
def test_what_is_no_time(text: str) -> None:
    assert ns_from_decimal_seconds(text) is None


def test_a_time_keeps_digits_that_a_float_would_lose(folder: Path) -> None:
    stamp = "1305031102.175304001"
    shutil.copy(next((folder / "depth").iterdir()), folder / "depth/extra.png")
    (folder / "depth.txt").write_text(f"{stamp} depth/extra.png\n")
    with open_recording(folder) as recording:
        assert recording.read(DEPTH, 0).stamp_ns == 1305031102175304001
        assert int(float(stamp) * 1e9) != 1305031102175304001


def test_depth_is_what_open3d_reads(folder: Path) -> None:
    with open_recording(folder) as recording:
        depth_m = recording.read(DEPTH, 0).value.depth_m
    read = open3d.io.read_image
    pair = open3d.geometry.RGBDImage.create_from_tum_format(
        read(str(min((folder / "rgb").iterdir()))), read(str(min((folder / "depth").iterdir())))
    )
    theirs = np.array(pair.depth)
    # Open3D keeps 65535, which no such camera measures.
    theirs[(theirs == 0) | (theirs > 13.1)] = np.nan
    np.testing.assert_array_equal(depth_m, theirs)


def test_ground_truth_is_never_taken_for_odometry(folder: Path) -> None:
    with open_recording(folder) as recording:
        streams = choose_streams(recording)
    assert streams.odometry is None
    assert streams.pose is None
    assert streams.camera_info == (INFO,)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("1.5 ../rgbd_dataset/depth.txt", "outside of the folder"),
        ("1.5 depth/../../secret.png", "outside of the folder"),
        ("1.5 /etc/hostname", "outside of the folder"),
        (r"1.5 C:\secret.png", "outside of the folder"),
        ("1.5 depth/none.png", "not there"),
        ("1.5 depth", "not there"),
        ("1.5 " + "x" * 300, "not there"),
        ("1.5 " + "x" * 5000, "not there"),
        ("yesterday depth/none.png", "no stamp"),
        ("-1.5 depth/none.png", "no stamp"),
        ("1.5", "no stamp and file"),
        ("1.5 depth/a.png b", "no stamp and file"),
    ],
)
def test_a_bad_line_loses_only_itself(folder: Path, line: str, said: str) -> None:
    add_line(folder / "depth.txt", line)
    (warning,) = warnings(folder)
    assert said in warning
    assert warning.startswith("depth.txt: ")
    assert "line 8" in warning
    assert counts(folder) == {DEPTH: 5, COLOR: 5, INFO: 5, TRUTH: 12}


def test_bytes_that_are_no_text_lose_only_their_line(folder: Path) -> None:
    file = folder / "groundtruth.txt"
    file.write_bytes(file.read_bytes() + b"\xff\xfe\n")
    assert "it is no text" in warnings(folder)[0]
    assert counts(folder)[TRUTH] == 12


@pytest.mark.parametrize(
    "line", ["1.5 0 0 0 0 0 0 0", "1.5 nan 0 0 0 0 0 1", "1.5 0 0 0 1e200 0 0 1", "1.5 0 0 0"]
)
def test_a_bad_pose_loses_only_itself(folder: Path, line: str) -> None:
    add_line(folder / "groundtruth.txt", line)
    assert warnings(folder)[0].startswith("groundtruth.txt: 1 lines are left out; the first, line")
    assert counts(folder)[TRUTH] == 12


def test_unsorted_lists_are_sorted(folder: Path) -> None:
    with open_recording(folder) as recording:
        before = [m.stamp_ns for m in recording.messages()]
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt"):
        lines = (folder / name).read_text().splitlines()
        (folder / name).write_text("\n".join(reversed(lines)))
    with open_recording(folder) as recording:
        assert [m.stamp_ns for m in recording.messages()] == before
        assert [w.partition(":")[0] for w in recording.warnings] == [
            "depth.txt",
            "rgb.txt",
            "groundtruth.txt",
        ]


@pytest.mark.parametrize("fraction", [0.01, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("name", ["depth.txt", "rgb.txt", "groundtruth.txt", "calibration.txt"])
def test_a_truncated_list_gives_what_precedes_the_cut(
    folder: Path, name: str, fraction: float
) -> None:
    whole = counts(folder)
    content = (folder / name).read_bytes()
    kept = content[: int(len(content) * fraction)]
    (folder / name).write_bytes(kept)
    found = counts(folder)
    topic = {"depth.txt": DEPTH, "rgb.txt": COLOR, "groundtruth.txt": TRUTH}.get(name, INFO)
    lines = [line for line in kept.split(b"\n")[:-1] if not line.startswith(b"#")]
    if topic != INFO:
        # The cut line itself may still be whole, but for its end.
        assert len(lines) <= found.get(topic, 0) <= len(lines) + 1
        assert {t: n for t, n in found.items() if t not in (topic, INFO)} == {
            t: n for t, n in whole.items() if t not in (topic, INFO)
        }


def test_a_truncated_image_loses_only_itself(folder: Path) -> None:
    file = sorted((folder / "depth").iterdir())[2]
    file.write_bytes(file.read_bytes()[:60])
    with open_recording(folder) as recording:
        assert [m.index for m in recording.messages([DEPTH])] == [0, 1, 3, 4]
        assert file.name in recording.warnings[0]


def test_without_calibration_and_name_there_are_no_intrinsics(folder: Path) -> None:
    (folder / "calibration.txt").unlink()
    assert INFO not in counts(folder)


@pytest.mark.parametrize(
    ("name", "fx", "has_distortion"),
    [
        ("rgbd_dataset_freiburg1_xyz", 517.3, True),
        ("rgbd_dataset_freiburg2_desk", 520.9, True),
        ("fr3_office", 535.4, False),
    ],
)
def test_the_benchmarks_cameras_by_name(
    folder: Path, name: str, fx: float, has_distortion: bool
) -> None:
    (folder / "calibration.txt").unlink()
    for file in (folder / "depth").iterdir():
        cv2.imwrite(str(file), np.full((480, 640), 5000, np.uint16))
    renamed = folder.rename(folder.with_name(name))
    with open_recording(renamed) as recording:
        intrinsics = recording.read(INFO, 0).value.intrinsics
        assert "published" in recording.warnings[0]
    assert intrinsics.fx == fx
    assert any(intrinsics.distortion) is has_distortion


def test_published_intrinsics_are_for_their_image_size_alone(folder: Path) -> None:
    (folder / "calibration.txt").unlink()
    renamed = folder.rename(folder.with_name("rgbd_dataset_freiburg2_desk"))
    assert INFO not in counts(renamed)
    assert "(640, 480)" in warnings(renamed)[0]


@pytest.mark.parametrize("name", ["freiburg4", "fr10_office", "afr1", "desk"])
def test_other_names_are_no_cameras_of_the_benchmark(folder: Path, name: str) -> None:
    (folder / "calibration.txt").unlink()
    renamed = folder.rename(folder.with_name(name))
    assert INFO not in counts(renamed)
    assert warnings(renamed) == []


def test_the_unit_of_depth_can_be_stated(folder: Path) -> None:
    with open_recording(folder) as recording:
        before = recording.read(DEPTH, 0).value.depth_m
    (folder / "calibration.txt").unlink()
    (folder / "camera.json").write_text('{"depth_scale": 2500}')
    with open_recording(folder) as recording:
        np.testing.assert_allclose(recording.read(DEPTH, 0).value.depth_m, 2 * before, rtol=1e-6)


def test_pairs_in_one_list(folder: Path) -> None:
    with open_recording(folder) as recording:
        before = {t: [m.stamp_ns for m in recording.messages([t])] for t in (DEPTH, COLOR)}
    depth, color = (
        [line for line in (folder / name).read_text().splitlines() if not line.startswith("#")]
        for name in ("depth.txt", "rgb.txt")
    )
    # Both orders of the columns are in use.
    pairs = [f"{d} {c}" for d, c in zip(depth, color, strict=True)]
    pairs[::2] = [f"{c} {d}" for d, c in zip(depth[::2], color[::2], strict=True)]
    (folder / "associations.txt").write_text("\n".join(pairs))
    for name in ("depth.txt", "rgb.txt"):
        (folder / name).unlink()
    with open_recording(folder) as recording:
        assert {t: [m.stamp_ns for m in recording.messages([t])] for t in before} == before
        assert not recording.stamps_are_nominal


def test_numbered_pairs_have_no_clock(folder: Path) -> None:
    """As ICL-NUIM has them."""
    for kind in ("depth", "rgb"):
        (folder / f"{kind}.txt").unlink()
        for number, file in enumerate(sorted((folder / kind).iterdir()), start=8):
            file.rename(file.with_name(f"{number}.png"))
    lines = [f"{n} depth/{n}.png {n} rgb/{n}.png" for n in range(8, 13)]
    (folder / "associations.txt").write_text("\n".join(lines))
    with open_recording(folder) as recording:
        assert recording.stamps_are_nominal
        assert recording.start_ns is None
        stamps = [m.stamp_ns for m in recording.messages([DEPTH])]
        assert stamps == [n * 10**9 // 30 for n in range(5)]
        assert "groundtruth.txt is left out" in recording.warnings[0]
        assert TRUTH not in {topic.name for topic in recording.topics}


def test_color_alone(folder: Path) -> None:
    (folder / "depth.txt").unlink()
    assert counts(folder) == {COLOR: 5, TRUTH: 12}


def test_a_folder_in_place_of_a_list(folder: Path) -> None:
    (folder / "groundtruth.txt").unlink()
    (folder / "groundtruth.txt").mkdir()
    assert counts(folder) == {DEPTH: 5, COLOR: 5, INFO: 5}


def test_a_file_in_place_of_the_images(folder: Path) -> None:
    shutil.rmtree(folder / "depth")
    (folder / "depth").write_text("")
    found = warnings(folder)
    assert "5 lines are left out" in found[0]
    assert counts(folder) == {COLOR: 5, TRUTH: 12}


def test_lists_of_missing_images(folder: Path) -> None:
    for kind in ("depth", "rgb"):
        shutil.rmtree(folder / kind)
        (folder / kind).mkdir()
    with pytest.raises(RecordingError, match=r"no images that are there.*is not there"):
        open_recording(folder)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_list_without_permission_loses_only_its_topic(folder: Path) -> None:
    (folder / "rgb.txt").chmod(0)
    assert "Permission denied" in warnings(folder)[0]
    assert counts(folder) == {DEPTH: 5, INFO: 5, TRUTH: 12}


def test_a_list_beyond_the_limit(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fusion_core.recordings.images.tum_folder.MAX_FILES", 5)
    assert "what follows line 5 is left out" in warnings(folder)[0]
    monkeypatch.setattr("fusion_core.recordings.images.tum_folder._MAX_LIST_BYTES", 300)
    assert any("larger than 300 bytes" in warning for warning in warnings(folder))


@pytest.mark.data
def test_the_benchmarks_truth_as_evo_has_it(folder: Path, data_folder: Path) -> None:
    file = data_folder / "real/trajectories/fr2_desk_groundtruth.txt"
    shutil.copy(file, folder / "groundtruth.txt")
    table = np.loadtxt(file)
    with open_recording(folder) as recording:
        poses = list(recording.messages([TRUTH]))
    assert len(poses) == len(table)
    np.testing.assert_allclose([m.stamp_ns / 1e9 for m in poses], table[:, 0], atol=1e-6)
    np.testing.assert_array_equal([m.value.T_parent_child[:3, 3] for m in poses], table[:, 1:4])


@pytest.mark.data
def test_a_pair_of_the_benchmark(tmp_path: Path, data_folder: Path) -> None:
    source = data_folder / "real/rgbd/redwood_and_odd_encodings/other_formats"
    folder = tmp_path / "rgbd_dataset_freiburg1_one"
    for kind, name in (("rgb", "TUM_color.png"), ("depth", "TUM_depth.png")):
        (folder / kind).mkdir(parents=True)
        shutil.copy(source / name, folder / kind / "1.5.png")
        (folder / f"{kind}.txt").write_text(f"1.5 {kind}/1.5.png\n")
    with open_recording(folder) as recording:
        depth_m = recording.read(DEPTH, 0).value.depth_m
        assert recording.read(INFO, 0).value.intrinsics.fx == 517.3
    assert np.nanmax(depth_m) == np.float32(46655 / 5000)
    assert np.isnan(depth_m).sum() == (cv2.imread(str(source / "TUM_depth.png"), -1) == 0).sum()
