"""The row of a recording of a batch."""

import csv
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.conventions import NS_PER_S
from fusion_core.simulation.scenes import SceneSettings, write_scene
from fusion_core.workflows.batch import rows as rows_module
from fusion_core.workflows.batch.columns import (
    COLUMNS,
    UNKNOWN_TEXT,
    arrow_batch,
    arrow_schema,
    column_of,
    format_with_deviation,
    unknown_row,
)
from fusion_core.workflows.batch.rows import read_row
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions
from tests.workflows.batch.made_outcomes import (
    MONDAY_NS,
    alignment_of,
    done,
    failed,
    frame,
    fused,
    write_run,
)


def row_of_frames(batch: Path, frames: list[dict[str, Any]], **alignment: Any) -> dict[str, Any]:
    return read_row(fused(batch, "a", frames, **alignment), batch / "runs" / "a")


def test_each_column_is_declared_once_and_explained() -> None:
    names = [column.name for column in COLUMNS]
    assert len(set(names)) == len(names)
    for column in COLUMNS:
        assert column.help
        assert column.label
        assert column.sd_of is None or column.sd_of in names


@pytest.mark.parametrize(("sd", "text"), [(0.028, "11.7 ± 2.8"), (0.0004, "11.7"), (None, "11.7")])
def test_a_deviation_is_shown_where_its_digits_are(sd: float | None, text: str) -> None:
    name = "depth_conflict_share"
    row = unknown_row() | {name: 0.117, f"{name}_sd": sd}
    assert format_with_deviation(column_of(name), row) == text


def test_a_real_run_has_the_row_that_its_files_tell(tmp_path: Path) -> None:
    recording, output = tmp_path / "room.mcap", tmp_path / "runs" / "room"
    settings = SceneSettings(seed=9, duration_s=3.0, image_scale=0.5, camera_rate_hz=10.0)
    write_scene("bedroom", recording, settings=settings)
    summary = fuse(recording, output, FuseOptions(maps=False, figures=False))
    row = read_row(done("room", summary.to_json()), output)

    with (output / "frames.csv").open(newline="", encoding="utf-8") as file:
        frames = list(csv.DictReader(file))
    stamps = [
        int(value) for one in frames for key in ("stamp_ns", "scan_stamp_ns") if (value := one[key])
    ]
    assert row["start_ns"] == min(stamps)
    assert row["duration_s"] == pytest.approx((max(stamps) - min(stamps)) / 1e9)
    assert (row["frames"], row["paired"]) == (summary.frames, summary.paired)
    counts = summary.lidar_counts
    assert row["lidar_hole_share"] == pytest.approx(counts["hole"] / sum(counts.values()))
    for key in ("yaw_rad", "yaw_rad_sd", "clock_offset_ms", "agreement"):
        assert row[key] == summary.document[key]
    assert row["untrusted_share"] == 0.0
    assert row["geometry"] == "LiDAR 682 beams 240°, camera 160 × 120 58°"
    assert row["warnings"] == []


def test_a_failed_recording_has_its_reason_and_no_numbers(tmp_path: Path) -> None:
    row = read_row(failed("b"), tmp_path)
    told = {name for name, value in row.items() if value not in (None, [])}
    assert told == {
        "name",
        "state",
        "recording",
        "robot",
        "command",
        "error",
        "advice",
        "seconds",
        "recorded_bytes",
    }
    assert (row["state"], row["error"], row["advice"]) == (
        "failed",
        "is cut off.",
        "Copy it again.",
    )


def test_what_the_recording_does_not_show_is_null(tmp_path: Path) -> None:
    row = row_of_frames(
        tmp_path,
        [frame(0, lidar_good=None, depth_good=None, scan_stamp_ns=None)],
        clock_offset_ms=None,
        clock_offset_ms_sd=None,
        agreement=None,
    )
    for name in (
        "clock_offset_ms",
        "clock_offset_ms_sd",
        "agreement",
        "lidar_hole_share",
        "untrusted_share",
        "untrusted_stretches",
    ):
        assert row[name] is None, name


def test_stretches_of_untrusted_images(tmp_path: Path) -> None:
    trusted, not_here = {"row_model": "row"}, {"row_model": "row", "u_alone": 95.0}
    unmatched = {"row_model": None, "u": None, "u_alone": None}
    unpaired = {**unmatched, "scan_stamp_ns": None}
    on_curve = {"row_model": "curve", "u_alone": 95.0}
    kinds = [trusted, not_here, not_here, trusted, unmatched, unpaired, not_here, on_curve]
    row = row_of_frames(tmp_path, [frame(n, **kind) for n, kind in enumerate(kinds)])
    assert row["untrusted_share"] == 4 / 7
    assert row["untrusted_stretches"] == 3


@pytest.mark.parametrize(("beams", "is_trusted"), [(1024, True), (682, False)])
def test_offsets_of_a_full_circle_are_compared_around_it(
    tmp_path: Path, beams: int, is_trusted: bool
) -> None:
    lidar = {"angle_increment_rad": 2.0 * np.pi / 1024.0, "beams": beams, "samples": 360}
    row = row_of_frames(tmp_path, [frame(0, row_model="row", u=359.6, u_alone=0.2)], lidar=lidar)
    assert row["untrusted_share"] == (0.0 if is_trusted else 1.0)


@given(
    st.lists(st.sampled_from(["curve", "lost", "lost", "row"]), min_size=30, max_size=60), st.data()
)
def test_blocks_of_any_size_tell_the_same(kinds: list[str], data: st.DataObject) -> None:
    frames = [
        frame(
            n,
            row_model="curve" if kind == "curve" else "row",
            u_alone=99.0 if kind == "lost" else 80.0,
            lidar_hole=n % 7,
        )
        for n, kind in enumerate(kinds)
    ]
    with pytest.MonkeyPatch.context() as patch, TemporaryDirectory() as name:
        folder = Path(name)
        whole = row_of_frames(folder / "whole", frames)
        patch.setattr(rows_module, "_BLOCK_BYTES", data.draw(st.integers(600, 1500)))
        assert row_of_frames(folder / "blocks", frames) == whole
    lost = [kind == "lost" for kind in kinds]
    assert whole["untrusted_stretches"] == sum(
        now and not before for before, now in zip([False, *lost], lost, strict=False)
    )


def test_the_start_is_the_first_stamp_of_either_sensor(tmp_path: Path) -> None:
    row = row_of_frames(tmp_path, [frame(0), frame(1, scan_stamp_ns=None)])
    assert row["start_ns"] == MONDAY_NS - 3_000_000
    assert row["duration_s"] == pytest.approx(0.103)
    assert column_of("start_ns").format(MONDAY_NS) == "2023-11-14 22:13:20"
    assert column_of("start_ns").format(5 * NS_PER_S) == "5.0 s"


def test_results_that_cannot_be_read_are_told(tmp_path: Path) -> None:
    row = read_row(fused(tmp_path, "a", [frame(0)]), tmp_path / "elsewhere")
    assert row["lidar_hole_share"] is None
    assert row["warnings"][0].startswith("The results cannot be read back: FileNotFoundError")
    (tmp_path / "runs" / "a" / "frames.csv").write_text("camera\n/camera\n", encoding="utf-8")
    row = read_row(fused(tmp_path / "b", "a", [frame(0)]), tmp_path / "runs" / "a")
    assert row["warnings"][0].startswith("The results cannot be read back: ArrowKeyError")


def test_numbers_that_are_none_are_null(tmp_path: Path) -> None:
    row = row_of_frames(
        tmp_path, [frame(0)], yaw_rad="7", score=float("nan"), agreement=7.0, left_m=True
    )
    assert [row[name] for name in ("yaw_rad", "peak_score", "agreement", "left_m")] == [None] * 4


def test_a_map_is_told_by_its_report(tmp_path: Path) -> None:
    trajectory = "# timestamp tx ty tz qx qy qz qw\n1700000000.012500000 0 0 0 0 0 0 1\n"
    (tmp_path / "trajectory.tum").write_text(trajectory, encoding="utf-8")
    result = {
        "duration_s": 7.5,
        "scans": 70,
        "scans_recorded": 80,
        "trusted_share": 0.75,
        "untrusted": [{"from_s": 1.0, "to_s": 2.0, "scans": 10}],
    }
    row = read_row(done("m", result, command="map"), tmp_path)
    assert row["start_ns"] == 1_700_000_000_012_500_000
    assert (row["frames"], row["paired"], row["untrusted_share"]) == (80, 70, 0.25)
    assert row["untrusted_stretches"] == 1


def test_the_rooms_of_a_data_set_have_no_row_of_numbers(tmp_path: Path) -> None:
    row = read_row(done("home", {"rooms": []}), tmp_path)
    assert row["warnings"] == ["These are several rooms: each has results of its own."]


def test_hostile_names_are_printable(tmp_path: Path) -> None:
    row = read_row(failed("a\x1b[2J\u202eb", error="x\ny", advice="\udcff"), tmp_path)
    assert row["name"] == "a\\x1b[2J\\u202eb"
    assert row["error"] == "x\\ny"
    assert row["advice"] == "\\xff"


def test_rows_become_a_table_with_units_and_nulls(tmp_path: Path) -> None:
    write_run(tmp_path / "runs" / "a", [frame(0)])
    result = {"frames": 1, "paired": 1, "alignment": alignment_of(pitch_rad=None)}
    row = read_row(done("a", result), tmp_path / "runs" / "a")
    table = pa.Table.from_batches([arrow_batch([row, unknown_row()], arrow_schema({"a": "b"}))])
    assert table.schema.metadata == {b"a": b"b"}
    assert table.schema.field("yaw_rad").metadata[b"unit"] == b"rad"
    assert table["yaw_rad"].to_pylist() == [0.12, None]
    assert table["pitch_rad"].to_pylist() == [None, None]
    assert table["flags"].to_pylist() == [[], []]


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("yaw_rad", np.radians(7.0), "7.00"),
        ("agreement", 0.8643, "86.4"),
        ("recorded_bytes", 12_345_678, "12.3"),
        ("frames", 0, "0"),
        ("frames", None, UNKNOWN_TEXT),
        ("flags", ["mount moved", "clock drifts"], "mount moved; clock drifts"),
    ],
)
def test_values_as_they_are_shown(name: str, value: Any, text: str) -> None:
    assert column_of(name).format(value) == text
