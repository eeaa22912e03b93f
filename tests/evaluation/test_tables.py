"""Rows for the terminal carry the numbers of the reports."""

import numpy as np

from fusion_core.evaluation.alignment import AlignmentReport, OffsetHits
from fusion_core.evaluation.noise import NoiseReport
from fusion_core.evaluation.repair import RepairReport
from fusion_core.evaluation.repair_errors import RepairErrors
from fusion_core.evaluation.tables import alignment_table, noise_table, repair_table


def _noise(good: int, mislabelled: int) -> NoiseReport:
    pairs = np.zeros((5, 4, 4), np.int64)
    pairs[0, 0, 0], pairs[0, 2, 0] = good, mislabelled
    return NoiseReport(
        pairs=pairs,
        conflicts_changed=0,
        lidar_holes=0,
        lidar_holes_labelled=0,
        depth_holes=0,
        depth_holes_labelled=0,
    )


def test_noise_rows_end_with_all_pairs_pooled() -> None:
    header, first, second, pooled = noise_table({"a": _noise(9, 1), "b": _noise(45, 45)})
    assert [row[1] for row in (header, first, second, pooled)] == ["ξ", "0.900", "0.500", "0.540"]
    assert first[2] == "–"
    assert (first[0], pooled[0]) == ("a", "all")
    assert pooled[-1] == "100/0/0"


def test_one_recording_needs_no_pooled_row() -> None:
    assert [row[0] for row in noise_table({"a": _noise(1, 0)})] == ["recording", "a"]


def test_alignment_rows_have_one_score_each() -> None:
    report = AlignmentReport(
        u_true=np.array([80.0]),
        hits={
            "u": OffsetHits(frames=4, within=3),
            "u_alone": OffsetHits(frames=4, within=1),
            "u_cosine": OffsetHits(frames=4, within=2),
        },
        mount_error={"yaw_rad": np.deg2rad(-0.5)},
        clock_offset_true_ms=40.0,
        clock_interval_ms=(30.04, 50.0),
    )
    rows = alignment_table({"a": report, "b": report})
    assert rows[1] == (
        "a", "chosen", "0.750 of 4", "0.250 of 4", "-0.50°", "[30, 50] ms contains truth"
    )  # fmt: skip
    assert rows[2][1:4] == ("cosine", "0.500 of 4", "–")
    assert rows[-2][:3] == ("all", "chosen", "0.750 of 8")


def test_repair_rows_are_in_millimetres() -> None:
    errors = RepairErrors(
        wide=np.array([True]),
        hole=np.array([True]),
        source=np.array([1]),
        error_m=np.array([0.0123]),
        behind=np.array([False]),
        baseline_error_m={"linear": np.array([0.1])},
        wanted_wide=2,
        wanted_narrow=0,
        wanted_holes=2,
        returns=999,
        returns_moved_farther=1,
    )
    rows = repair_table({"a": RepairReport(lidar=errors, depth=errors)})
    assert rows[1] == (
        "a", "LiDAR", "≥ 3°", "0.500 of 2", "12.3 / 12.3 / 12.3", "linear 100.0 / 100.0 / 100.0",
        "0.0010",
    )  # fmt: skip
    assert rows[2][3:5] == ("– of 0", "– / – / –")
