"""Evaluations as rows of text, header first: one row for each recording and one for all of them."""

from collections.abc import Mapping, Sequence

import numpy as np

from fusion_core.evaluation.alignment import METRICS, AlignmentReport, OffsetHits, pool_hits
from fusion_core.evaluation.noise import NoiseReport, pool_noise
from fusion_core.evaluation.repair import RepairReport, pool_repair
from fusion_core.evaluation.repair_errors import RepairErrors

Row = tuple[str, ...]

POOLED = "all"


def alignment_table(reports: Mapping[str, AlignmentReport]) -> list[Row]:
    """Per recording and score, the fraction of frames within 2 samples, with prior and alone."""
    rows: list[Row] = [("recording", "score", "with prior", "alone", "yaw error", "clock")]
    for name, report in reports.items():
        yaw, clock = _format_degrees(report.yaw_error_deg), _format_clock(report)
        rows += [(name, *cells, yaw, clock) for cells in _hit_rows(report.hits)]
    if len(reports) > 1:
        pooled = pool_hits(list(reports.values()))
        rows += [(POOLED, *cells, "", "") for cells in _hit_rows(pooled)]
    return rows


def noise_table(reports: Mapping[str, NoiseReport]) -> list[Row]:
    """Per recording, every recall and the number of its pairs."""
    rows: list[Row] = [
        (
            "recording",
            "ξ",
            "η",
            "attribution",
            "conflicts",
            "changed",
            "LiDAR holes",
            "depth holes",
            "pairs good/noise/conflict",
        )
    ]
    named = dict(reports)
    if len(reports) > 1:
        named[POOLED] = pool_noise(list(reports.values()))
    for name, report in named.items():
        counts = report.to_json()
        rows.append(
            (
                name,
                _format_fraction(report.good_recall),
                _format_fraction(report.noise_recall),
                _format_fraction(report.attribution),
                _format_fraction(report.conflict_recall),
                _format_fraction(report.conflict_changed),
                _format_fraction(report.lidar_hole_recall),
                _format_fraction(report.depth_hole_recall),
                "{good_pairs}/{noise_pairs}/{conflict_pairs}".format(**counts),
            )
        )
    return rows


def repair_table(reports: Mapping[str, RepairReport]) -> list[Row]:
    """Per recording, sensor and width of gap: median / 90th percentile / RMS in millimetres."""
    rows: list[Row] = [
        ("recording", "sensor", "gap", "repaired", "own mm", "baselines mm", "moved farther")
    ]
    named = dict(reports)
    if len(reports) > 1:
        named[POOLED] = pool_repair(list(reports.values()))
    for name, report in named.items():
        for sensor, errors in (("LiDAR", report.lidar), ("depth", report.depth)):
            rows += [(name, sensor, *cells) for cells in _gap_rows(errors)]
    return rows


def _hit_rows(hits: Mapping[str, OffsetHits]) -> list[Row]:
    rows: list[Row] = []
    for suffix, score in (("", "chosen"), *((f"_{metric}", metric) for metric in METRICS)):
        names = f"u{suffix}", f"u_alone{suffix}"
        if any(name in hits for name in names):
            rows.append((score, *(_format_hits(hits.get(name)) for name in names)))
    return rows


def _format_hits(hits: OffsetHits | None) -> str:
    return "–" if hits is None else f"{_format_fraction(hits.fraction)} of {hits.frames}"


def _gap_rows(errors: RepairErrors) -> list[Row]:
    entries = errors.to_json()
    rows: list[Row] = []
    for gap, width in (("wide", "≥ 3°"), ("narrow", "< 3°")):
        entry = entries[gap]
        baselines = [
            f"{baseline} {_format_errors(entry[baseline])}" for baseline in errors.baseline_error_m
        ]
        rows.append(
            (
                width,
                f"{_format_fraction(entry['repaired'])} of {entry['wanted']}",
                _format_errors(entry["own"]),
                ", ".join(baselines) or "–",
                _format_fraction(entries["moved_farther"], digits=4),
            )
        )
    return rows


def _format_errors(entry: Mapping[str, float | None]) -> str:
    values: Sequence[float | None] = [entry[name] for name in ("median_m", "p90_m", "rms_m")]
    return " / ".join("–" if value is None else f"{value * 1000.0:.1f}" for value in values)


def _format_fraction(value: float | None, digits: int = 3) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _format_degrees(value: float | None) -> str:
    return "–" if value is None else f"{value:+.2f}°"


def _format_clock(report: AlignmentReport) -> str:
    if report.clock_interval_ms is None:
        return "not observable"
    low, high = np.round(report.clock_interval_ms, 1)
    verdict = {None: "", True: " contains truth", False: " misses truth"}
    return f"[{low:g}, {high:g}] ms{verdict[report.clock_contains_truth]}"
