"""Result folders and truths written by hand, so that every measure has a known value."""

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

TOPIC = "/camera/depth/image_raw"

SAMPLE_TYPES = {
    "camera": pa.string(),
    "stamp_ns": pa.int64(),
    "scan_stamp_ns": pa.int64(),
    "lidar_beam": pa.int32(),
    "depth_row": pa.int32(),
    "depth_column": pa.int32(),
    "lidar_class": pa.int8(),
    "depth_class": pa.int8(),
    "lidar_confidence": pa.float64(),
    "depth_confidence": pa.float64(),
    "residual_m": pa.float64(),
    "lidar_raw_m": pa.float64(),
    "lidar_repaired_m": pa.float64(),
    "lidar_source": pa.string(),
    "depth_raw_m": pa.float64(),
    "depth_repaired_m": pa.float64(),
    "depth_source": pa.string(),
}

# LiDAR and optical axes share their origin; the camera looks along the LiDAR's x.
FACING_FORWARD = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


class ByHand:
    """Writes small results and truths below a temporary folder."""

    topic = TOPIC
    facing_forward = FACING_FORWARD

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def row(self, **values: Any) -> dict[str, Any]:
        """A row of samples.parquet: both sides good, raw and 1 m, unless told."""
        row: dict[str, Any] = dict.fromkeys(SAMPLE_TYPES)
        row |= {
            "camera": TOPIC,
            "stamp_ns": 0,
            "scan_stamp_ns": 0,
            "lidar_beam": 0,
            "depth_row": 0,
            "depth_column": 0,
            "lidar_class": 0,
            "depth_class": 0,
            "lidar_raw_m": 1.0,
            "lidar_repaired_m": 1.0,
            "lidar_source": "raw",
            "depth_raw_m": 1.0,
            "depth_repaired_m": 1.0,
            "depth_source": "raw",
        }
        assert values.keys() <= row.keys()
        return row | values

    def outside(self, **values: Any) -> dict[str, Any]:
        """A row whose point lies outside the image."""
        nulls = dict.fromkeys(
            ("depth_row", "depth_column", "depth_class", "depth_raw_m", "depth_repaired_m")
        )
        return self.row(**nulls, depth_source=None) | values

    def camera(self, *, width: int, height: int, focal: float, **values: Any) -> dict[str, Any]:
        """A camera of alignment.json, its optical axis through the image's middle."""
        return {
            "topic": TOPIC,
            "width": width,
            "height": height,
            "fx": focal,
            "fy": focal,
            "cx": (width - 1) / 2,
            "cy": (height - 1) / 2,
            "T_lidar_camera": None,
        } | values

    def lidar(self, *, beams: int, **values: Any) -> dict[str, Any]:
        """The LiDAR of alignment.json: one beam a degree around x, one sample a beam."""
        return {
            "angle_min_rad": float(-np.deg2rad((beams - 1) / 2)),
            "angle_increment_rad": float(np.deg2rad(1.0)),
            "beams": beams,
            "range_max_m": 5.6,
            "samples": beams,
        } | values

    def results(
        self,
        rows: list[dict[str, Any]],
        *,
        lidar: dict[str, Any],
        cameras: list[dict[str, Any]],
        frames: list[dict[str, Any]] | None = None,
        name: str = "fused",
        **alignment: Any,
    ) -> Path:
        """The three files that an evaluation reads."""
        path = self.folder / name
        path.mkdir(exist_ok=True)
        content = alignment | {"lidar": lidar, "cameras": cameras}
        (path / "alignment.json").write_text(json.dumps(content))
        columns = {
            column: pa.array([row[column] for row in rows], kind)
            for column, kind in SAMPLE_TYPES.items()
        }
        pq.write_table(pa.table(columns), path / "samples.parquet", row_group_size=7)
        needed = dict.fromkeys(("u", "u_alone", "overlap", "mean_error_m"))
        keys = {"camera": TOPIC, "stamp_ns": 0, "scan_stamp_ns": 0}
        frames = [keys | needed | frame for frame in frames or [{}]]
        with (path / "frames.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, list(frames[0]))
            writer.writeheader()
            writer.writerows(frames)
        return path

    def truth(self, *, name: str = "truth.npz", **arrays: Any) -> Path:
        """A truth file; stamps count from 0 unless given, the camera faces forward."""
        content = {
            "scan_stamp": np.arange(len(arrays["scan_true"]), dtype=np.int64),
            "cam_yaw": np.float64(0.0),
            "T_lidar_camera": FACING_FORWARD,
        }
        if arrays.get("depth_true") is not None:
            content["depth_stamp"] = np.arange(len(arrays["depth_true"]), dtype=np.int64)
        content |= arrays
        path = self.folder / name
        np.savez(path, **{key: array for key, array in content.items() if array is not None})
        return path


@pytest.fixture
def by_hand(tmp_path: Path) -> ByHand:
    """A writer of results and truths in a folder of this test's own."""
    return ByHand(tmp_path)


@pytest.fixture
def in_new_folder(tmp_path_factory: pytest.TempPathFactory) -> Callable[[], ByHand]:
    """A writer in a new folder at each call, for the examples of a property."""
    return lambda: ByHand(tmp_path_factory.mktemp("by_hand"))
