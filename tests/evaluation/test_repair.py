"""Repairs against truth and baselines: exact on a wall with gaps of known width."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fusion_core.evaluation import fuse_folder
from fusion_core.evaluation.repair import evaluate_repair, pool_repair
from fusion_core.evaluation.truth import Truth, load_truth
from fusion_core.model.errors import ScanLoomError

GOOD, HOLE, BURR = range(3)
BEAMS = 12
HEIGHT, WIDTH, FOCAL = 6, 40, 40.0

# One beam a degree: a gap of three beams (3 degrees), and one of two.
KIND = np.array([0, 0, 1, 1, 1, 0, 0, 1, 2, 0, 0, 0])
RANGE = np.array([1.0, 2.0, 2.5, 3.5, 4.5, 6.0, 4.0, 4.0, 4.0, 4.0, 4.0, 4.0])


def _truth(by_hand: Any, **arrays: Any) -> Truth:
    own = {
        "scan_true": RANGE[np.newaxis],
        "scan_kind": KIND[np.newaxis],
        "depth_true": np.full((1, HEIGHT, WIDTH), 2000),
        "depth_kind": np.zeros((1, HEIGHT, WIDTH), np.uint8),
    }
    return load_truth(by_hand.truth(**(own | arrays)))


def _results(by_hand: Any, rows: list[dict[str, Any]], range_max_m: float = 7.0) -> Path:
    return by_hand.results(
        rows,
        lidar=by_hand.lidar(beams=BEAMS, range_max_m=range_max_m),
        cameras=[by_hand.camera(width=WIDTH, height=HEIGHT, focal=FOCAL)],
    )


def _beam(by_hand: Any, beam: int, repaired_m: float | None, **values: Any) -> dict[str, Any]:
    """A beam whose raw value is the true one, a burr's 1 m too near, and a hole's missing."""
    raw_m = {GOOD: RANGE[beam], HOLE: None, BURR: RANGE[beam] - 1.0}[int(KIND[beam])]
    source = "raw" if KIND[beam] == GOOD else "other_sensor"
    row = by_hand.outside(
        lidar_beam=beam, lidar_raw_m=raw_m, lidar_repaired_m=repaired_m, lidar_source=source
    )
    return row | values


def _all_beams(by_hand: Any, error_m: dict[int, float]) -> list[dict[str, Any]]:
    return [_beam(by_hand, beam, RANGE[beam] + error_m.get(beam, 0.0)) for beam in range(BEAMS)]


def test_lidar_errors_by_width_of_the_gap_and_those_of_linear_interpolation(by_hand: Any) -> None:
    rows = _all_beams(by_hand, {2: 0.1, 3: -0.2, 4: 0.6, 7: 0.01, 8: -0.03})
    lidar = evaluate_repair(_results(by_hand, rows), _truth(by_hand)).to_json()["lidar"]
    assert (lidar["wide"]["wanted"], lidar["wide"]["repaired"]) == (3, 1.0)
    assert lidar["wide"]["own"] == pytest.approx(
        {"count": 3, "median_m": 0.2, "p90_m": 0.52, "rms_m": np.sqrt((0.01 + 0.04 + 0.36) / 3)}
    )
    # Between 2 m at beam 1 and 6 m at beam 5: 3, 4, 5 m where 2.5, 3.5, 4.5 m are true.
    linear = lidar["wide"]["linear"]
    assert (linear["median_m"], linear["p90_m"], linear["rms_m"]) == pytest.approx((0.5,) * 3)
    assert linear["own_to_median"] == pytest.approx(0.4)
    # The burr at beam 8 is valid to the baseline: 3 m itself, and 3.5 m at beam 7.
    assert lidar["narrow"]["linear"]["median_m"] == pytest.approx(0.75)
    assert lidar["narrow"]["own"]["median_m"] == pytest.approx(0.02)


def test_unrepaired_samples_lower_only_the_repaired_fraction(by_hand: Any) -> None:
    rows = [
        _beam(by_hand, 2, 2.6),
        _beam(by_hand, 3, None, lidar_source="none"),
        _beam(by_hand, 3, 3.5, lidar_source="none"),
        _beam(by_hand, 4, 4.5, lidar_source="raw"),
        _beam(by_hand, 7, 4.0, lidar_source="neighbours"),
    ]
    lidar = evaluate_repair(_results(by_hand, rows), _truth(by_hand)).to_json()["lidar"]
    assert lidar["wide"]["repaired"] == pytest.approx(1 / 4)
    assert lidar["wide"]["own"]["count"] == 1
    assert lidar["by_source"]["other_sensor"]["median_m"] == pytest.approx(0.1)
    assert lidar["by_source"]["neighbours"]["median_m"] == 0.0


def test_a_beam_beyond_the_maximum_range_is_not_counted(by_hand: Any) -> None:
    path = _results(by_hand, _all_beams(by_hand, {}), range_max_m=3.5)
    wide = evaluate_repair(path, _truth(by_hand)).to_json()["lidar"]["wide"]
    assert (wide["wanted"], wide["own"]["count"]) == (2, 2)


def test_outside_the_view_the_baseline_reads_true_ranges_of_good_beams(by_hand: Any) -> None:
    rows = [_beam(by_hand, beam, RANGE[beam]) for beam in (2, 3, 4)]
    lidar = evaluate_repair(_results(by_hand, rows), _truth(by_hand)).lidar
    np.testing.assert_allclose(lidar.baseline_error_m["linear"], 0.5)


def test_angles_may_fall_along_the_scan(by_hand: Any) -> None:
    rows = _all_beams(by_hand, {2: 0.1})
    step = -np.deg2rad(1.0)
    truth = _truth(by_hand, lidar_angle_min=np.float64(0.1), lidar_angle_increment=np.float64(step))
    lidar = evaluate_repair(_results(by_hand, rows), truth).lidar
    assert int(lidar.wide.sum()) == 3
    np.testing.assert_allclose(lidar.baseline_error_m["linear"][lidar.wide], 0.5)


@pytest.mark.parametrize(
    ("raw_m", "repaired_m", "moved"),
    [
        (4.0, 4.0, 0),
        (4.0, 4.129, 0),
        (4.0, 4.131, 1),
        (4.2, 4.2, 0),
        (3.9, 4.131, 1),
        (4.0, 3.0, 0),
        (4.0, None, 0),
    ],
)
def test_a_true_return_moved_farther_is_counted(
    by_hand: Any, raw_m: float, repaired_m: float | None, moved: int
) -> None:
    rows = [_beam(by_hand, 10, repaired_m, lidar_raw_m=raw_m), _beam(by_hand, 11, 4.0)]
    lidar = evaluate_repair(_results(by_hand, rows), _truth(by_hand)).lidar
    assert (lidar.returns_moved_farther, lidar.moved_farther, lidar.returns) == (moved, moved, 2)
    assert lidar.moved_farther_fraction == moved / 2


def test_what_is_filled_behind_the_true_surface_is_counted_for_each_source(by_hand: Any) -> None:
    """The true ranges of beams 2, 3, 4, 7, 8 are 2.5, 3.5, 4.5, 4 and 4 m; beam 8 is a burr."""
    rows = [
        _beam(by_hand, 2, 2.79),
        _beam(by_hand, 3, 3.81),
        _beam(by_hand, 4, 4.0),
        _beam(by_hand, 7, 4.4, lidar_source="neighbours"),
        _beam(by_hand, 8, 4.31, lidar_source="neighbours"),
        _beam(by_hand, 10, 5.0),
        _beam(by_hand, 11, 4.0),
    ]
    lidar = evaluate_repair(_results(by_hand, rows), _truth(by_hand)).to_json()["lidar"]
    behind = {source: entry["behind_surface"] for source, entry in lidar["by_source"].items()}
    assert behind == pytest.approx({"all": 3 / 5, "other_sensor": 1 / 3, "neighbours": 1.0})
    assert lidar["by_source"]["all"]["count"] == 5
    # One of two true returns, and three of five filled beams.
    assert lidar["returns_moved_farther"] == 0.5
    assert lidar["moved_farther"] == pytest.approx(4 / 7)


def test_holes_filled_leaves_out_the_burrs(by_hand: Any) -> None:
    rows = [
        _beam(by_hand, 2, 2.5),
        _beam(by_hand, 3, None, lidar_source="none"),
        _beam(by_hand, 4, None, lidar_source="none"),
        _beam(by_hand, 8, 4.0),
    ]
    lidar = evaluate_repair(_results(by_hand, rows), _truth(by_hand)).to_json()["lidar"]
    assert (lidar["holes"], lidar["holes_filled"]) == (3, pytest.approx(1 / 3))


def _pixel(by_hand: Any, row: int, column: int, **values: Any) -> dict[str, Any]:
    return by_hand.row(
        lidar_beam=0,
        depth_row=row,
        depth_column=column,
        **({"depth_raw_m": None, "depth_source": "other_sensor"} | values),
    )


def _depth_kind(*, wide: slice, narrow: slice) -> Any:
    kind = np.zeros((1, HEIGHT, WIDTH), np.uint8)
    kind[0, 1, wide] = HOLE
    kind[0, 4, narrow] = BURR
    return kind


def test_depth_errors_by_width_of_the_gap_in_the_row(by_hand: Any) -> None:
    # Near the axis a pixel is 1.43 degrees wide: three make a wide gap, two a narrow one.
    kind = _depth_kind(wide=slice(18, 21), narrow=slice(18, 20))
    rows = [
        _pixel(by_hand, 1, 19, depth_repaired_m=2.3),
        _pixel(by_hand, 1, 20, depth_repaired_m=None),
        _pixel(by_hand, 4, 18, depth_repaired_m=1.9, depth_raw_m=1.0),
        _pixel(by_hand, 2, 5, depth_repaired_m=2.2, depth_raw_m=2.0),
    ]
    depth = evaluate_repair(_results(by_hand, rows), _truth(by_hand, depth_kind=kind)).to_json()[
        "depth"
    ]
    assert (depth["wide"]["wanted"], depth["wide"]["repaired"]) == (2, 0.5)
    assert depth["wide"]["own"]["median_m"] == pytest.approx(0.3)
    assert depth["narrow"]["own"]["median_m"] == pytest.approx(0.1)
    assert (depth["returns"], depth["returns_moved_farther"]) == (1, 1.0)
    assert "inpaint" not in depth["wide"]


def test_gaps_of_a_camera_on_its_side_run_along_columns(by_hand: Any) -> None:
    kind = np.zeros((1, HEIGHT, WIDTH), np.uint8)
    kind[0, 1:4, 7] = HOLE
    sideways = by_hand.facing_forward @ np.array(
        [[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], np.float64
    )
    rows = [_pixel(by_hand, 2, 7, depth_repaired_m=2.0)]
    for mount, wide in ((sideways, 1), (by_hand.facing_forward, 0)):
        truth = _truth(by_hand, depth_kind=kind, T_lidar_camera=mount)
        report = evaluate_repair(_results(by_hand, rows), truth)
        assert report.depth.wanted_wide == wide


def test_depth_baselines_fill_the_raw_image(by_hand: Any) -> None:
    kind = _depth_kind(wide=slice(10, 20), narrow=slice(30, 31))
    raw_m = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    raw_m[:, :11] = 1.0
    raw_m[1, 10:20] = np.nan
    raw_m[4, 30] = 1.5
    rows = [
        _pixel(by_hand, 1, 18, depth_repaired_m=2.1),
        _pixel(by_hand, 4, 30, depth_repaired_m=2.1, depth_raw_m=1.5),
    ]
    path, truth = _results(by_hand, rows), _truth(by_hand, depth_kind=kind)
    images = [("/other", 0, raw_m), (by_hand.topic, 7, raw_m), (by_hand.topic, 0, raw_m)]
    depth = evaluate_repair(path, truth, images).depth
    np.testing.assert_allclose(depth.baseline_error_m["nearest"], [0.0, 0.5])
    np.testing.assert_allclose(depth.baseline_error_m["inpaint"], [0.0, 0.5], atol=2e-3)
    with pytest.raises(ScanLoomError, match=r"no raw image of .* with stamp 0"):
        evaluate_repair(path, truth, images[:2])


def test_a_recording_without_rows_has_no_repairs(by_hand: Any) -> None:
    report = evaluate_repair(_results(by_hand, []), _truth(by_hand), []).to_json()
    assert report["lidar"]["wide"]["own"]["median_m"] is None
    assert report["depth"]["moved_farther"] is None


def _random_rows(by_hand: Any, seed: int) -> list[dict[str, Any]]:
    rng = np.random.default_rng(seed)
    rows = []
    for beam in rng.integers(0, BEAMS, 60):
        row = _beam(by_hand, int(beam), float(RANGE[beam] + rng.normal(0.0, 0.1)))
        if rng.random() < 0.6:
            row |= {
                "depth_row": int(rng.integers(HEIGHT)),
                "depth_column": int(rng.integers(WIDTH)),
                "depth_class": 0,
                "depth_raw_m": None,
                "depth_repaired_m": float(rng.uniform(1.0, 3.0)),
                "depth_source": str(rng.choice(["neighbours", "other_sensor"])),
            }
        rows.append(row)
    return rows


@settings(max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(order=st.permutations(range(60)), batch=st.integers(5, 80))
def test_neither_order_nor_batches_change_anything(
    in_new_folder: Callable[[], Any], order: list[int], batch: int
) -> None:
    by_hand = in_new_folder()
    rows = _random_rows(by_hand, seed=3)
    truth = _truth(by_hand, depth_kind=_depth_kind(wide=slice(0, 30), narrow=slice(3, 4)))
    image = np.full((HEIGHT, WIDTH), 2.2, np.float32)
    image[1, :30] = np.nan
    images = [(by_hand.topic, 0, image)]
    as_written = evaluate_repair(_results(by_hand, rows), truth, images).to_json()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fuse_folder, "_BATCH_ROWS", batch)
        path = _results(by_hand, [rows[n] for n in order])
        shuffled = evaluate_repair(path, truth, images).to_json()
    assert _rounded(shuffled) == _rounded(as_written)


def _rounded(entry: Any) -> Any:
    """Sums of squares depend on the order in their last digits."""
    if isinstance(entry, dict):
        return {key: _rounded(value) for key, value in entry.items()}
    return round(entry, 12) if isinstance(entry, float) else entry


def test_pooling_takes_quantiles_over_all_samples(by_hand: Any) -> None:
    truth = _truth(by_hand)
    parts = _random_rows(by_hand, 1), _random_rows(by_hand, 2)
    reports = [evaluate_repair(_results(by_hand, rows), truth) for rows in parts]
    pooled = pool_repair(reports)
    errors = np.concatenate([report.lidar.error_m for report in reports])
    wide = np.concatenate([report.lidar.wide for report in reports])
    entry = pooled.to_json()["lidar"]["wide"]
    assert entry["own"]["median_m"] == pytest.approx(np.median(errors[wide]))
    assert entry["own"]["p90_m"] == pytest.approx(np.percentile(errors[wide], 90))
    assert entry["wanted"] == sum(report.lidar.wanted_wide for report in reports)
    assert pooled.depth.baseline_error_m == {}
