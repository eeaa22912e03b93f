"""Reading results: nulls, batches, and invalid content."""

from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from fusion_core.evaluation import fuse_folder
from fusion_core.evaluation.fuse_folder import (
    MISSING,
    open_fuse_folder,
    read_frames,
    read_samples,
)
from fusion_core.model.classes import RepairSource
from fusion_core.model.errors import ScanLoomError


def _layout(by_hand: Any) -> dict[str, Any]:
    return {
        "lidar": by_hand.lidar(beams=3),
        "cameras": [by_hand.camera(width=4, height=2, focal=2.0)],
    }


def test_rows_come_in_order_with_nulls_marked(
    by_hand: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [by_hand.row(stamp_ns=n, lidar_raw_m=None) for n in range(20)]
    rows[3] = by_hand.outside(stamp_ns=3, lidar_source="neighbours", lidar_raw_m=None)
    folder = open_fuse_folder(by_hand.results(rows, **_layout(by_hand)))
    monkeypatch.setattr(fuse_folder, "_BATCH_ROWS", 6)
    batches = list(read_samples(folder))
    assert len(batches) == 4
    stamps = np.concatenate([samples.stamp_ns for samples in batches])
    assert stamps.tolist() == list(range(20))
    samples = batches[0]
    assert np.isnan(samples.lidar_raw_m).all()
    assert samples.lidar_source[3] == RepairSource.NEIGHBOURS
    for values in (samples.depth_row, samples.depth_column, samples.depth_class):
        assert values[3] == MISSING
    assert samples.depth_source[3] == MISSING
    assert 3 not in samples.paired


def test_large_stamps_and_empty_columns_of_frames_survive(by_hand: Any) -> None:
    stamp_ns = 1_700_000_000_079_666_667
    frames = [
        {"stamp_ns": stamp_ns, "scan_stamp_ns": None},
        {"stamp_ns": 2, "scan_stamp_ns": stamp_ns},
    ]
    folder = open_fuse_folder(by_hand.results([], frames=frames, **_layout(by_hand)))
    read = read_frames(folder)
    assert read.stamp_ns.tolist() == [stamp_ns, 2]
    assert read.scan_stamp_ns.tolist() == [MISSING, stamp_ns]
    assert np.isnan(read.number["u"]).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lidar_beam": 3}, "lidar_beam holds 3"),
        ({"lidar_class": 4}, "lidar_class holds 4"),
        ({"depth_row": 2}, "depth_row holds 2"),
        ({"depth_column": 4}, "depth_column holds 4"),
        ({"depth_class": None}, "depth_class"),
        ({"lidar_source": "guess"}, "lidar_source 'guess'"),
        ({"camera": "/other"}, "camera '/other'"),
    ],
)
def test_unknown_classes_sources_and_pixels_are_named(
    by_hand: Any, change: dict[str, Any], message: str
) -> None:
    folder = open_fuse_folder(by_hand.results([by_hand.row(**change)], **_layout(by_hand)))
    with pytest.raises(ScanLoomError, match=message) as caught:
        list(read_samples(folder))
    assert caught.value.file is not None
    assert caught.value.file.endswith("samples.parquet")


def test_missing_columns_and_files_are_typed_errors(by_hand: Any) -> None:
    path = by_hand.results([by_hand.row()], **_layout(by_hand))
    folder = open_fuse_folder(path)
    table = pq.read_table(path / "samples.parquet").drop_columns(["residual_m"])
    pq.write_table(table, path / "samples.parquet")
    with pytest.raises(ScanLoomError, match="no column residual_m"):
        list(read_samples(folder))
    (path / "frames.csv").write_text("camera,stamp_ns\n")
    with pytest.raises(ScanLoomError, match="no column scan_stamp_ns"):
        read_frames(folder)
    for name, read in (("samples.parquet", read_samples), ("frames.csv", read_frames)):
        (path / name).unlink()
        with pytest.raises(ScanLoomError, match=name):
            list(read(folder))  # type: ignore[operator]


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"lidar": {"beams": "x"}, "cameras": []}'])
def test_an_invalid_alignment_is_a_typed_error(by_hand: Any, content: str) -> None:
    path = by_hand.results([], **_layout(by_hand))
    (path / "alignment.json").write_text(content)
    with pytest.raises(ScanLoomError, match=r"alignment\.json"):
        open_fuse_folder(path)


def test_estimated_mount_and_intrinsics_are_read_where_given(by_hand: Any) -> None:
    mount = np.arange(16.0).reshape(4, 4)
    cameras = [
        by_hand.camera(width=4, height=2, focal=2.0, T_lidar_camera=mount.tolist()),
        by_hand.camera(width=4, height=2, focal=2.0, topic="/second", fx=None),
    ]
    path = by_hand.results([], lidar=by_hand.lidar(beams=3), cameras=cameras, preset="default")
    folder = open_fuse_folder(path)
    assert folder.alignment["preset"] == "default"
    assert folder.topics == [by_hand.topic, "/second"]
    np.testing.assert_array_equal(folder.cameras[0].T_lidar_camera, mount)
    assert folder.cameras[0].intrinsics == (2.0, 2.0, 1.5, 0.5)
    assert folder.cameras[1].T_lidar_camera is None
    assert folder.cameras[1].intrinsics is None
