"""What ``scanloom map`` reports: report.json's content, and the same for people."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.model.conventions import NS_PER_S, BoolArray, FloatArray, IntArray
from fusion_core.model.number_text import counted
from fusion_core.slam.particle_filter_slam import ParticleResult
from fusion_core.slam.pose_graph_slam import SlamResult
from fusion_core.workflows.map.estimators import PlacedScans

# Of more intervals than fit on a screen only the longest are printed.
_INTERVALS_PRINTED = 8


@dataclass(frozen=True, kw_only=True)
class MapSummary:
    """What a run has to report: report.json's content, and the seconds of its stages.

    The seconds are in no file, since they differ from run to run; a skipped run has none.
    """

    output: Path
    is_skipped: bool
    report: dict[str, Any]
    seconds: Mapping[str, float]

    def to_json(self) -> dict[str, Any]:
        """One machine-readable result."""
        return {
            "output": str(self.output),
            "skipped": self.is_skipped,
            **self.report,
            "seconds": dict(self.seconds),
        }

    def lines(self) -> list[str]:
        """The same for people."""
        report = self.report
        lines = [
            f"scans      {report['scans']} of {report['duration_s']:.1f} s, "
            f"{report['path_m']:.1f} m path",
        ]
        if "loops" in report:
            lines.append(
                f"graph      {counted(report['key_scans'], 'keyframe')}, "
                f"{counted(report['edges'], 'edge')}, {counted(report['loops'], 'loop')} "
                f"({report['loops_dropped']} dropped)"
            )
        if "particles" in report:
            lines.append(
                f"particles  {report['particles']}, {report['key_scans']} scans weighed, "
                f"{report['resamplings']} times resampled"
            )
        longest = sorted(report["untrusted"], key=lambda interval: -int(interval["scans"]))
        for interval in sorted(longest[:_INTERVALS_PRINTED], key=lambda entry: entry["from_s"]):
            lines.append(
                f"untrusted  {interval['from_s']:.3f} s to {interval['to_s']:.3f} s: "
                f"{counted(interval['scans'], 'scan')}"
            )
        if len(longest) > _INTERVALS_PRINTED:
            lines.append(
                f"untrusted  {len(longest) - _INTERVALS_PRINTED} shorter ones in report.json"
            )
        lines += [f"time       {name} {value:.1f} s" for name, value in self.seconds.items()]
        lines += [f"note       {note}" for note in report["notes"]]
        if self.is_skipped:
            lines.append("Nothing was done, the results were there already (--force redoes).")
        return [*lines, f"results    {self.output}"]


def build_report(
    placed: PlacedScans,
    recorded_count: int,
    choices: Mapping[str, str],
    notes: Sequence[str],
) -> dict[str, Any]:
    """report.json's content. ``recorded_count``: scans in the recording; those that are not
    placed are not trusted. ``choices``: the run's options, by name."""
    steps_m = np.hypot(*np.diff(placed.poses_map_scan[:, :2], axis=0).T)
    report: dict[str, Any] = {
        **choices,
        "scans": int(placed.stamps_ns.size),
        "scans_recorded": recorded_count,
        "duration_s": float(placed.stamps_ns[-1] - placed.stamps_ns[0]) / 1e9,
        "path_m": float(steps_m.sum()),
        "trusted_share": float(placed.trusted.sum() / recorded_count),
        "untrusted": untrusted_intervals(placed.stamps_ns, placed.trusted),
        "notes": [*notes],
    }
    if placed.graph is not None:
        report |= _graph_report(placed.stamps_ns, placed.graph)
    if placed.particles is not None:
        report |= _particle_report(placed.stamps_ns, placed.particles)
    return report


def _particle_report(stamps_ns: IntArray, result: ParticleResult) -> dict[str, Any]:
    times_s = stamps_ns[result.keyframes] / NS_PER_S
    return {
        "key_scans": int(result.keyframes.size),
        "particles": int(result.weights.size),
        "resamplings": int(result.resampled.sum()),
        "unmatched": int(result.unmatched.sum()),
        "effective": [
            list(pair) for pair in zip(times_s.tolist(), _or_none(result.effective), strict=True)
        ],
    }


def _or_none(values: FloatArray) -> list[float | None]:
    """JSON has no NaN."""
    return [float(value) if np.isfinite(value) else None for value in values]


def _graph_report(stamps_ns: IntArray, result: SlamResult) -> dict[str, Any]:
    graph = result.graph
    residual_norm_m = np.hypot(*result.residuals[:, :2].T)
    return {
        "key_scans": int(result.keyframes.size),
        "edges": int(graph.first.size),
        "loops": result.loops,
        "loops_tried": result.loops_tried,
        "loops_dropped": result.loops_dropped,
        "surface_adjustment": {
            "adjusted": result.adjusted.is_adjusted,
            "odometry": {
                name: {"scale": scale, "widened": widened}
                for name, scale, widened in zip(
                    result.adjusted.odometry_names,
                    result.adjusted.odometry_scales,
                    result.adjusted.odometry_factors,
                    strict=True,
                )
            },
        },
        "loop_closures": [
            {
                "first_s": float(stamps_ns[result.keyframes[graph.first[edge]]]) / 1e9,
                "second_s": float(stamps_ns[result.keyframes[graph.second[edge]]]) / 1e9,
                "residual_m": float(residual_norm_m[edge]),
                "residual_rad": float(result.residuals[edge, 2]),
            }
            for edge in np.flatnonzero(graph.is_loop)
        ],
    }


def untrusted_intervals(stamps_ns: IntArray, trusted: BoolArray) -> list[dict[str, Any]]:
    """Each run of scans that cannot be trusted: stamps of its first and last, and how many."""
    turns = np.flatnonzero(np.diff(np.concatenate([[True], trusted, [True]]).astype(np.int8)))
    return [
        {
            "from_s": float(stamps_ns[first]) / 1e9,
            "to_s": float(stamps_ns[end - 1]) / 1e9,
            "scans": int(end - first),
        }
        for first, end in zip(turns[::2], turns[1::2], strict=True)
    ]
