"""Recalls of good, noise and conflict pairs: exact on every kind of pair, and against a loop."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fusion_core.evaluation import fuse_folder
from fusion_core.evaluation.noise import evaluate_noise, pool_noise
from fusion_core.evaluation.recall_curve import pool_recall, recall_over_epsilon
from fusion_core.evaluation.truth import Truth, load_truth
from fusion_core.model.errors import ScanLoomError

GOOD, HOLE, BURR, CONFLICT = range(4)

# Beam k is 1 m long and paired with the pixel in row k of the middle column, whose depth is its
# horizontal range: (class of the beam, class of the pixel, depth in mm, kind of the pair).
PAIRS = [
    (GOOD, GOOD, 1000, "good"),
    (GOOD, GOOD, 1099, "good"),
    (GOOD, GOOD, 1101, "conflict"),
    (GOOD, GOOD, 899, "conflict"),
    (GOOD, GOOD, 2500, "conflict"),
    (BURR, GOOD, 1000, "lidar_burr"),
    (BURR, GOOD, 3000, "lidar_burr"),
    (GOOD, BURR, 1000, "depth_burr"),
    (BURR, BURR, 1000, "burrs"),
    (HOLE, GOOD, 1000, None),
    (BURR, HOLE, 1000, None),
    (GOOD, HOLE, 1000, None),
    (HOLE, HOLE, 1000, None),
    (GOOD, GOOD, 0, None),
]
COUNT = len(PAIRS)
FIRST = {"good": 0, "conflict": 2, "lidar_burr": 5, "depth_burr": 7, "burrs": 8}


def _truth(by_hand: Any) -> Truth:
    lidar, depth, depth_mm = (np.array([pair[n] for pair in PAIRS]) for n in range(3))
    spread = np.ones(3, np.int64)
    return load_truth(
        by_hand.truth(
            scan_true=np.ones((1, COUNT)),
            scan_kind=lidar[np.newaxis],
            depth_true=(depth_mm[:, np.newaxis] * spread)[np.newaxis],
            depth_kind=(depth[:, np.newaxis] * spread)[np.newaxis],
        )
    )


def _fused(by_hand: Any, labels: dict[int, tuple[int, int]], **change: dict[int, Any]) -> Path:
    """A folder with all pairs, labelled as in truth (conflict for conflicts) unless told."""
    rows = []
    for k, (lidar, depth, _, kind) in enumerate(PAIRS):
        own = (CONFLICT, CONFLICT) if kind == "conflict" else (lidar, depth)
        lidar_label, depth_label = labels.get(k, own)
        values = {name: by_row[k] for name, by_row in change.items() if k in by_row}
        rows.append(
            by_hand.row(
                lidar_beam=k,
                depth_row=k,
                depth_column=1,
                lidar_class=lidar_label,
                depth_class=depth_label,
                **values,
            )
        )
    return _written(by_hand, rows)


def _written(by_hand: Any, rows: list[dict[str, Any]], **frame: Any) -> Path:
    return by_hand.results(
        rows,
        lidar=by_hand.lidar(beams=COUNT),
        cameras=[by_hand.camera(width=3, height=COUNT, focal=2.0)],
        frames=[frame],
    )


def test_a_perfect_labeller_scores_one(by_hand: Any) -> None:
    report = evaluate_noise(_fused(by_hand, {}), _truth(by_hand)).to_json()
    for name in ("xi", "eta", "attribution", "conflict_recall", "conflict_recall_either"):
        assert report[name] == 1.0
    assert report["conflict_changed"] == 0.0
    assert (report["good_pairs"], report["conflict_pairs"], report["noise_pairs"]) == (2, 3, 4)
    assert (report["lidar_hole_recall"], report["depth_hole_recall"]) == (1.0, 1.0)
    assert (report["lidar_holes"], report["depth_holes"]) == (2, 3)


def test_an_inverted_labeller_scores_zero(by_hand: Any) -> None:
    inverted = {
        k: (BURR, BURR) if kind == "good" else (GOOD, GOOD)
        for k, (_, _, _, kind) in enumerate(PAIRS)
    }
    changed = dict.fromkeys(range(COUNT), 1.5)
    report = evaluate_noise(
        _fused(by_hand, inverted, lidar_repaired_m=changed), _truth(by_hand)
    ).to_json()
    for name in ("xi", "eta", "conflict_recall", "conflict_recall_either"):
        assert report[name] == 0.0
    assert report["attribution"] is None
    assert report["conflict_changed"] == 1.0
    assert (report["lidar_hole_recall"], report["depth_hole_recall"]) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("kind", "label", "measure", "expected"),
    [
        ("good", (GOOD, CONFLICT), "xi", 1 / 2),
        ("good", (HOLE, GOOD), "xi", 1 / 2),
        ("lidar_burr", (GOOD, GOOD), "eta", 3 / 4),
        ("lidar_burr", (CONFLICT, CONFLICT), "eta", 3 / 4),
        ("lidar_burr", (GOOD, BURR), "eta", 1.0),
        ("lidar_burr", (GOOD, BURR), "attribution", 3 / 4),
        ("lidar_burr", (BURR, BURR), "attribution", 3 / 4),
        ("lidar_burr", (BURR, CONFLICT), "attribution", 1.0),
        ("lidar_burr", (GOOD, GOOD), "attribution", 1.0),
        ("depth_burr", (BURR, GOOD), "attribution", 3 / 4),
        ("depth_burr", (BURR, BURR), "attribution", 3 / 4),
        ("depth_burr", (HOLE, BURR), "attribution", 1.0),
        ("burrs", (BURR, GOOD), "eta", 1.0),
        ("burrs", (BURR, GOOD), "attribution", 3 / 4),
        ("burrs", (GOOD, BURR), "attribution", 3 / 4),
        ("conflict", (CONFLICT, GOOD), "conflict_recall", 2 / 3),
        ("conflict", (CONFLICT, GOOD), "conflict_recall_either", 1.0),
        ("conflict", (GOOD, CONFLICT), "conflict_recall_either", 1.0),
        ("conflict", (BURR, BURR), "conflict_recall_either", 2 / 3),
    ],
)
def test_one_wrong_label_changes_each_measure_by_its_fraction(
    by_hand: Any, kind: str, label: tuple[int, int], measure: str, expected: float
) -> None:
    report = evaluate_noise(_fused(by_hand, {FIRST[kind]: label}), _truth(by_hand))
    assert report.to_json()[measure] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("raw", "repaired", "changed"),
    [(1.0, 1.0, 0), (1.0, 1.0000001, 1), (None, None, 0), (None, 1.0, 1), (1.0, None, 1)],
)
@pytest.mark.parametrize("sensor", ["lidar", "depth"])
def test_a_changed_conflict_is_counted(
    by_hand: Any, sensor: str, raw: float | None, repaired: float | None, changed: int
) -> None:
    at = FIRST["conflict"]
    values = {f"{sensor}_raw_m": {at: raw}, f"{sensor}_repaired_m": {at: repaired}}
    report = evaluate_noise(_fused(by_hand, {}, **values), _truth(by_hand))
    assert report.conflicts_changed == changed


def test_a_point_outside_the_image_is_no_pair_but_may_be_a_hole(by_hand: Any) -> None:
    rows = [by_hand.outside(lidar_beam=beam, lidar_class=GOOD) for beam in range(COUNT)]
    report = evaluate_noise(_written(by_hand, rows), _truth(by_hand))
    assert report.pairs.sum() == 0
    assert (report.lidar_holes, report.lidar_holes_labelled) == (2, 0)
    assert report.to_json()["xi"] is None


def _random_rows(by_hand: Any, seed: int, count: int = 80) -> list[dict[str, Any]]:
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(count):
        where = rng.integers(COUNT)
        row = by_hand.row(
            lidar_beam=int(where if rng.random() < 0.7 else rng.integers(COUNT)),
            depth_row=int(where),
            depth_column=int(rng.integers(3)),
            lidar_class=int(rng.integers(4)),
            depth_class=int(rng.integers(4)),
            residual_m=None if rng.random() < 0.1 else float(rng.uniform(0.0, 0.2)),
            lidar_repaired_m=float(rng.choice([1.0, 1.5])),
        )
        rows.append(row)
    return rows


def _kind_by_loop(row: dict[str, Any]) -> str | None:
    lidar = PAIRS[row["lidar_beam"]][0]
    _, depth, depth_mm, _ = PAIRS[row["depth_row"]]
    if HOLE in (lidar, depth):
        return None
    if BURR in (lidar, depth):
        return "noise"
    if depth_mm == 0:
        return None
    sideways_m = (row["depth_column"] - 1) / 2.0 * depth_mm / 1000.0
    apart_m = abs(np.sqrt((depth_mm / 1000.0) ** 2 + sideways_m**2) - 1.0)
    return "good" if apart_m < 0.10 else "conflict"


def _right_by_loop(row: dict[str, Any]) -> bool:
    true = (PAIRS[row["lidar_beam"]][0] == BURR, PAIRS[row["depth_row"]][1] == BURR)
    return (row["lidar_class"] == BURR, row["depth_class"] == BURR) == true


@pytest.mark.parametrize("seed", range(6))
def test_every_measure_equals_that_of_a_loop(by_hand: Any, seed: int) -> None:
    rows = _random_rows(by_hand, seed)
    report = evaluate_noise(_written(by_hand, rows), _truth(by_hand)).to_json()
    good = [row for row in rows if _kind_by_loop(row) == "good"]
    noise = [row for row in rows if _kind_by_loop(row) == "noise"]
    conflict = [row for row in rows if _kind_by_loop(row) == "conflict"]
    found = [row for row in noise if BURR in (row["lidar_class"], row["depth_class"])]
    labels = [(row["lidar_class"], row["depth_class"]) for row in conflict]
    assert report["xi"] == pytest.approx(
        sum((row["lidar_class"], row["depth_class"]) == (GOOD, GOOD) for row in good) / len(good)
    )
    assert report["eta"] == pytest.approx(len(found) / len(noise))
    assert report["attribution"] == pytest.approx(sum(map(_right_by_loop, found)) / len(found))
    assert report["conflict_recall"] == pytest.approx(
        labels.count((CONFLICT, CONFLICT)) / len(conflict)
    )
    assert report["conflict_recall_either"] == pytest.approx(
        sum(CONFLICT in pair for pair in labels) / len(conflict)
    )
    assert report["conflict_changed"] == pytest.approx(
        sum(row["lidar_repaired_m"] != 1.0 for row in conflict) / len(conflict)
    )


@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(order=st.permutations(range(80)), batch=st.integers(5, 100))
def test_neither_order_nor_batches_change_anything(
    in_new_folder: Callable[[], Any], order: list[int], batch: int
) -> None:
    by_hand = in_new_folder()
    rows = _random_rows(by_hand, seed=1)
    truth = _truth(by_hand)
    as_written = evaluate_noise(_written(by_hand, rows), truth).to_json()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fuse_folder, "_BATCH_ROWS", batch)
        shuffled = _written(by_hand, [rows[n] for n in order])
        assert evaluate_noise(shuffled, truth).to_json() == as_written


def test_pooling_adds_pairs_and_not_fractions(by_hand: Any) -> None:
    truth = _truth(by_hand)
    parts = _random_rows(by_hand, 2, 30), _random_rows(by_hand, 3, 90)
    reports = [evaluate_noise(_written(by_hand, rows), truth) for rows in parts]
    together = evaluate_noise(_written(by_hand, parts[0] + parts[1]), truth)
    assert pool_noise(reports).to_json() == together.to_json()


def test_curve_thresholds_each_residual_at_factors_of_the_frames_error(by_hand: Any) -> None:
    rows = _random_rows(by_hand, 4)
    factors = np.array([0.0, 0.5, 1.0, np.sqrt(2.0), 3.0])
    path, truth = _written(by_hand, rows, mean_error_m=0.07), _truth(by_hand)
    curve = recall_over_epsilon(path, truth, factors).to_json()
    for k, factor in enumerate(factors):
        residuals = {
            kind: [
                row["residual_m"]
                for row in rows
                if _kind_by_loop(row) == kind and row["residual_m"] is not None
            ]
            for kind in ("good", "noise")
        }
        kept = sum(residual <= factor * 0.07 for residual in residuals["good"])
        found = sum(residual > factor * 0.07 for residual in residuals["noise"])
        assert curve["xi"][k] == pytest.approx(kept / curve["good_pairs"])
        assert curve["eta"][k] == pytest.approx(found / curve["noise_pairs"])
    assert curve["band"] == pytest.approx([1.0, 1.41421356])


def test_a_residual_equal_to_epsilon_is_kept_and_not_found(by_hand: Any) -> None:
    rows = [by_hand.row(lidar_beam=k, depth_row=k, depth_column=1) for k in range(COUNT)]
    rows = [row | {"residual_m": 0.25} for row in rows]
    path, truth = _written(by_hand, rows, mean_error_m=0.125), _truth(by_hand)
    curve = recall_over_epsilon(path, truth, np.array([1.99, 2.0])).to_json()
    assert (curve["xi"], curve["eta"]) == ([0.0, 1.0], [1.0, 0.0])


def test_a_frame_without_error_neither_keeps_nor_finds(by_hand: Any) -> None:
    rows = [by_hand.row(lidar_beam=k, depth_row=k, residual_m=0.01) for k in range(COUNT)]
    path, truth = _written(by_hand, rows, mean_error_m=None), _truth(by_hand)
    curve = recall_over_epsilon(path, truth, np.array([1.0]))
    assert (curve.good_kept.tolist(), curve.noise_found.tolist()) == ([0], [0])
    assert curve.good_pairs > 0


def test_curves_pool_over_equal_factors_only(by_hand: Any) -> None:
    path = _written(by_hand, _random_rows(by_hand, 5), mean_error_m=0.05)
    truth = _truth(by_hand)
    one = recall_over_epsilon(path, truth, np.array([1.0, 2.0]))
    both = pool_recall([one, one])
    assert both.to_json()["xi"] == one.to_json()["xi"]
    assert both.good_pairs == 2 * one.good_pairs
    with pytest.raises(ValueError, match="factors"):
        pool_recall([one, recall_over_epsilon(path, truth, np.array([1.0]))])


def test_a_stamp_that_the_truth_lacks_is_an_error(by_hand: Any) -> None:
    truth = _truth(by_hand)
    with pytest.raises(ScanLoomError, match="no scan with stamp 99"):
        evaluate_noise(_written(by_hand, [by_hand.row(scan_stamp_ns=99)]), truth)
    with pytest.raises(ScanLoomError, match="no depth image with stamp 99"):
        evaluate_noise(_written(by_hand, [by_hand.row(stamp_ns=99)]), truth)
