"""The report of a SLAM run as HTML; times count from the first scan."""

import html
from collections.abc import Iterator
from typing import Any

import numpy as np

from fusion_core.model.conventions import NS_PER_S
from fusion_core.workflows.map.visual_result_folder import VisualResults
from scanloom.jobs.slam_run import SlamRun
from scanloom.page.markup import report_line
from scanloom.plots.run_comparison import TrajectoryDifference
from scanloom.scene.duration_text import duration_text

# Set by hand; report.json lists all.
_MAX_SEGMENTS = 12


def run_report_html(run: SlamRun) -> str:
    """Path length, loop closures, unreliable segments, and computing time by stage, as HTML."""
    problem = ""
    if run.problem is not None:
        message = html.escape(f"{run.problem.problem} {run.problem.advice}")
        problem = f"<p style='margin:0.3em 0'><b>Not reliable:</b> {message}</p>"
    lines = "".join(report_line(f"{name:<11}{text}") for name, text in report_lines(run))
    return f"<div style='padding:0 0.8em;font-size:0.85em'>{problem}{lines}</div>"


def report_lines(run: SlamRun) -> Iterator[tuple[str, str]]:
    """Name and text of each line."""
    report = run.files.report
    if run.visual is not None:
        yield from visual_report_lines(run, run.visual)
        return
    yield "path", f"{report['path_m']:.1f} m in {duration_text(report['duration_s'])}"
    yield "scans", f"{report['scans']:,} placed"
    if "loops" in report:
        dropped = report.get("loops_dropped", 0)
        why = ", which the others contradict" if dropped else ""
        yield "loops", f"{report['loops']} closed, {dropped} dropped{why}"
    effective = run.files.effective
    effective = effective[np.isfinite(effective[:, 1])]
    if len(effective):
        least = effective[effective[:, 1].argmin()]
        zero_s = run.files.trajectory.stamps_ns[0] / NS_PER_S
        yield (
            "particles",
            f"{run.choices.particles}, resampled {report['resamplings']} times; "
            f"least effective number {least[1]:.1f} at {least[0] - zero_s:.1f} s",
        )
    yield "trusted", f"{100.0 * report['trusted_share']:.1f} % of the scans"
    yield from _unreliable_segments(run)
    for stage, seconds in ({} if run.summary is None else run.summary.seconds).items():
        yield "time", f"{stage.replace('_', ' ')} {duration_text(seconds)}"
    for note in report["notes"]:
        # The command line prints ASCII.
        yield "note", note.replace("+-", "±")


def visual_report_lines(run: SlamRun, visual: VisualResults) -> Iterator[tuple[str, str]]:
    """Name and text of each line about a run of visual SLAM."""
    report, stamps_ns = run.files.report, visual.trajectory.stamps_ns
    steps_m = np.linalg.norm(np.diff(visual.trajectory.T_map_body[:, :3, 3], axis=0), axis=1)
    duration_s = (stamps_ns[-1] - stamps_ns[0]) / NS_PER_S
    yield "path", f"{steps_m.sum():.1f} m in {duration_text(duration_s)}"
    of = f" of {report['images']:,}" if "images" in report else ""
    yield "images", f"{stamps_ns.size:,}{of} placed"
    yield "keyframes", f"{visual.stamps_ns.size}"
    yield "landmarks", f"{len(visual.landmarks_in_map_m):,}"
    yield "loops", f"{len(visual.loops)} closed"
    points = report.get("volumes", {}).get("points", 0)
    if points:
        yield "cloud", f"{points:,} points"
    yield from _stretches(report.get("lost", []), stamps_ns[0] / NS_PER_S)
    for jump in report.get("jumps", [])[:_MAX_SEGMENTS]:
        yield "jump", _jump_text(jump, stamps_ns[0] / NS_PER_S)
    for stage, seconds in ({} if run.summary is None else run.summary.seconds).items():
        yield "time", f"{stage.replace('_', ' ')} {duration_text(seconds)}"
    for note in report.get("notes", []):
        yield "note", note.replace("+-", "±")


def run_distance_text(found: TrajectoryDifference | None) -> str:
    """The distance between the trajectories of two runs, as text."""
    if found is None:
        return "The two runs have no time in common."
    if found.times_s.size == 1:
        return "The two runs have one pose in common, at which B is aligned to A."
    median_m, most = float(np.median(found.distances_m)), int(found.distances_m.argmax())
    farthest_m = float(found.distances_m[most])
    return (
        f"B is aligned to A at the first of {found.times_s.size} common poses. From there on their "
        f"distance is {_length(median_m)} in the median, at most {_length(farthest_m)}, "
        f"{found.times_s[most]:.1f} s later."
    )


def _length(length_m: float) -> str:
    return f"{length_m:.2f} m" if length_m >= 1.0 else f"{100.0 * length_m:.1f} cm"


def _unreliable_segments(run: SlamRun) -> Iterator[tuple[str, str]]:
    zero_s = run.files.trajectory.stamps_ns[0] / NS_PER_S
    segments = run.files.report["untrusted"]
    for segment in segments[:_MAX_SEGMENTS]:
        first, last = segment["from_s"] - zero_s, segment["to_s"] - zero_s
        when = f"{first:.1f} s to {last:.1f} s" if segment["scans"] > 1 else f"{first:.1f} s"
        many = "1 scan does" if segment["scans"] == 1 else f"{segment['scans']} scans do"
        yield "untrusted", f"{when}: {many} not fit the map"
    if len(segments) > _MAX_SEGMENTS:
        yield "untrusted", f"{len(segments) - _MAX_SEGMENTS} more segments, in report.json"


def _stretches(lost: list[dict[str, Any]], zero_s: float) -> Iterator[tuple[str, str]]:
    for stretch in lost[:_MAX_SEGMENTS]:
        first, last = stretch["from_s"] - zero_s, stretch["to_s"] - zero_s
        images = stretch.get("images", 0)
        many = f": {images} {'image' if images == 1 else 'images'}" if images else ""
        reason = stretch.get("reason", "")
        yield "lost", f"{first:.1f} s to {last:.1f} s{many}{f', {reason}' if reason else ''}"
    if len(lost) > _MAX_SEGMENTS:
        yield "lost", f"{len(lost) - _MAX_SEGMENTS} more times, in report.json"


def _jump_text(jump: dict[str, Any], zero_s: float) -> str:
    return f"{jump['step_m']:.2f} m at {jump['to_s'] - zero_s:.1f} s"
