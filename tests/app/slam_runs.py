"""Replaces ``build_map``: a known trajectory round a room, with the observer's views and the files
of a run."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.exporting.figures_slam import write_trajectory_figure
from fusion_core.exporting.ros_map import write_ros_map
from fusion_core.exporting.tum_trajectory import write_tum_trajectory
from fusion_core.model.conventions import NS_PER_S, FloatArray, IntArray
from fusion_core.model.errors import MappingFailed
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.progress import Progress
from fusion_core.model.slam_view import SlamObserver, SlamView, no_observer
from fusion_core.model.trajectory import Trajectory
from fusion_core.model.visual_slam_view import VisualSlamObserver, unobserved
from fusion_core.workflows.map.options import MapOptions
from fusion_core.workflows.map.report import MapSummary

SCANS = 60
PARTICLES = 12
# Scans 20 to 29 do not fit.
LOST = slice(20, 30)
LOOPS = ((2, 57), (4, 59))
SECONDS = {"motion": 0.5, "local_slam": 2.25}


def stamps_ns(first_ns: int = 1_600_000_000_123_456_789) -> IntArray:
    return np.arange(SCANS, dtype=np.int64) * (NS_PER_S // 10) + first_ns


def poses(shift_m: float = 0.0) -> FloatArray:
    """Round a room, (N, 3); shifted more and more to the side."""
    turn = np.linspace(0.0, 2.0 * np.pi, SCANS)
    drift = shift_m * np.arange(SCANS) / (SCANS - 1)
    return np.column_stack([2.0 * np.cos(turn), np.sin(turn) + drift, turn + 0.5 * np.pi])


def room() -> OccupancyGrid:
    """6 m by 4 m around the origin: free, with walls, and unknown outside."""
    log_odds = np.full((100, 140), np.nan)
    log_odds[10:90, 10:130] = -5.0
    for wall in (np.s_[10, 10:130], np.s_[89, 10:130], np.s_[10:90, 10], np.s_[10:90, 129]):
        log_odds[wall] = 5.0
    # Its mirror images are others.
    log_odds[20:25, 30:50] = 5.0
    return OccupancyGrid(resolution_m=0.05, origin_m=(-3.5, -2.5), log_odds=log_odds)


def effective() -> FloatArray:
    """(N,) effective numbers, weighed at each fifth scan."""
    values = np.full(SCANS, np.nan)
    values[::5] = PARTICLES / (1.0 + np.arange(SCANS // 5) % 4)
    return values


def view_at(count: int, stage: str, options: MapOptions) -> SlamView:
    """A moment of the run when so many scans are placed."""
    trajectory = poses()
    many = PARTICLES if options.slam == "particle-filter" else 0
    rng = np.random.default_rng(count)
    particles = trajectory[count - 1] + rng.normal(scale=0.03, size=(many, 3))
    weights = np.arange(1.0, many + 1.0)
    closed = LOOPS if stage == "closing loops" else ()
    ends = [[*trajectory[first, :2], *trajectory[second, :2]] for first, second in closed]
    return SlamView(
        stage=stage,
        stamps_ns=stamps_ns()[:count],
        poses_map_scan=trajectory[:count],
        particles=particles,
        weights=weights / weights.sum() if many else weights,
        effective=effective()[:count] if many else np.empty(0),
        loops_m=np.array(ends, dtype=np.float64).reshape(-1, 4),
    )


class FakeMap:
    """``build_map``, of which each call gets an ``at_scan(number)`` to wait in, or to fail in.

    ``shift_m``: how far the trajectory drifts; ``fits``: whether the scans fit the map at the end.
    """

    def __init__(self) -> None:
        self.calls: list[tuple[Path, Path, MapOptions]] = []
        self.at_scan: Callable[[int], None] = lambda number: None
        self.shift_m = 0.0
        self.fits = True

    def __call__(
        self,
        recording: Path,
        output: Path,
        options: MapOptions,
        progress: Progress,
        observer: SlamObserver = no_observer,
        visual_observer: VisualSlamObserver = unobserved,
    ) -> MapSummary:
        self.calls.append((recording, output, options))
        for number in range(1, SCANS + 1):
            progress(number, SCANS, "matching scans")
            self.at_scan(number)
            observer(view_at(number, "matching scans", options))
        if options.slam == "pose-graph":
            observer(view_at(SCANS, "closing loops", options))
        report = write_results(output, options, self.shift_m)
        if not self.fits:
            raise MappingFailed(
                "only 17 % of the scans fit the map.", file=output, advice="Look at the map."
            )
        return MapSummary(output=output, is_skipped=False, report=report, seconds=SECONDS)


def write_results(output: Path, options: MapOptions, shift_m: float = 0.0) -> dict[str, Any]:
    """The files of a run; returns what is in report.json."""
    output.mkdir(parents=True)
    trajectory, stamps = poses(shift_m), stamps_ns()
    write_ros_map(output, f"map_{options.scan}", room())
    write_tum_trajectory(output / "trajectory.tum", Trajectory.from_planar(stamps, trajectory))
    trusted = np.ones(SCANS, dtype=np.bool_)
    trusted[LOST] = False
    write_trajectory_figure(
        output / "trajectory.png", "a room", room(), trajectory, trusted, np.empty((0, 4))
    )
    report: dict[str, Any] = {
        "scan": options.scan,
        "motion": options.motion,
        "slam": options.slam,
        "scans": SCANS,
        "duration_s": 5.9,
        "path_m": 9.7,
        "trusted_share": 50 / 60,
        "untrusted": [
            {
                "from_s": float(stamps[LOST.start]) / 1e9,
                "to_s": float(stamps[LOST.stop - 1]) / 1e9,
                "scans": 10,
            }
        ],
        "notes": ["Motion from /odom.", "<b>& more"],
    }
    if options.slam == "pose-graph":
        (output / "graph.g2o").write_text("VERTEX_SE2 0 0 0 0\n", encoding="utf-8")
        report |= {
            "loops": 2,
            "loops_dropped": 1,
            "loop_closures": [
                {"first_s": float(stamps[first]) / 1e9, "second_s": float(stamps[second]) / 1e9}
                for first, second in LOOPS
            ],
        }
    if options.slam == "particle-filter":
        report |= {"particles": PARTICLES, "resamplings": 4}
        report["effective"] = [
            [float(stamp) / 1e9, value]
            for stamp, value in zip(stamps.tolist(), effective().tolist(), strict=True)
            if np.isfinite(value)
        ]
    if options.motion == "fused":
        sources = "wheel", "laser"
        kinds = "translation", "rotation", "rejected"
        names = [f"{source}_{kind}" for source in sources for kind in kinds]
        # Nothing is known of the third step.
        weights = [i / SCANS if i != 2 else None for i in range(SCANS - 1)]
        rows = [
            ["from_ns", "to_ns", *names],
            *(
                [
                    begin,
                    end,
                    weight,
                    0.25,
                    "false",
                    None if weight is None else 1.0 - weight,
                    0.75,
                    "true",
                ]
                for begin, end, weight in zip(stamps, stamps[1:], weights, strict=False)
            ),
        ]
        text = "".join(
            ",".join("" if value is None else str(value) for value in row) + "\n" for row in rows
        )
        (output / "odometry_weights.csv").write_text(text, encoding="utf-8")
    (output / "report.json").write_text(json.dumps(report), encoding="utf-8")
    return report
