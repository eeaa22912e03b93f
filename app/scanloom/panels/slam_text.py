"""The report of a SLAM run as HTML; times count from the first scan."""

import html
from collections.abc import Iterator

import numpy as np

from fusion_core.model.conventions import NS_PER_S
from scanloom.jobs.slam_run import SlamRun
from scanloom.plots.run_comparison import TrajectoryDifference

_MAX_SEGMENTS = 12
# Words that do not fit on a line go on under those above, right of the line's name.
_LINE = (
    "padding-left:11ch;text-indent:-11ch;white-space:pre-wrap;overflow-wrap:anywhere;"
    "font-family:ui-monospace,monospace;font-size:0.9em"
)


def run_report_html(run: SlamRun) -> str:
    """Path length, loop closures, unreliable segments, and computing time by stage, as HTML."""
    problem = ""
    if run.problem is not None:
        message = html.escape(f"{run.problem.problem} {run.problem.advice}")
        problem = f"<p style='margin:0.3em 0'><b>Not to be relied on:</b> {message}</p>"
    lines = "".join(
        f"<div style='{_LINE}'>{html.escape(f'{name:<11}{words}')}</div>"
        for name, words in report_lines(run)
    )
    return f"<div style='padding:0 0.5em;font-size:0.85em'>{problem}{lines}</div>"


def report_lines(run: SlamRun) -> Iterator[tuple[str, str]]:
    """Each line's name and words."""
    report = run.files.report
    yield "path", f"{report['path_m']:.1f} m in {report['duration_s']:.1f} s"
    yield "scans", f"{report['scans']} placed"
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
        yield "time", f"{stage.replace('_', ' ')} {seconds:.1f} s"
    for note in report["notes"]:
        # The notes are a terminal's, which may not have the sign.
        yield "note", note.replace("+-", "±")


def run_distance_text(found: TrajectoryDifference | None) -> str:
    """How far two runs are found."""
    if found is None:
        return "The two runs have no time in common."
    if found.times_s.size == 1:
        return "The two runs have one pose in common, by which B is laid on A."
    median_m, most = float(np.median(found.distances_m)), int(found.distances_m.argmax())
    farthest_m = float(found.distances_m[most])
    return (
        f"B is laid on A by the first of {found.times_s.size} common poses. From there on they are "
        f"{_length(median_m)} apart in the median, at most {_length(farthest_m)}, "
        f"{found.times_s[most]:.1f} s later."
    )


def _length(length_m: float) -> str:
    return f"{length_m:.2f} m" if length_m >= 1.0 else f"{100.0 * length_m:.1f} cm"


def _unreliable_segments(run: SlamRun) -> Iterator[tuple[str, str]]:
    zero_s = run.files.trajectory.stamps_ns[0] / NS_PER_S
    stretches = run.files.report["untrusted"]
    for stretch in stretches[:_MAX_SEGMENTS]:
        first, last = stretch["from_s"] - zero_s, stretch["to_s"] - zero_s
        when = f"{first:.1f} s to {last:.1f} s" if stretch["scans"] > 1 else f"{first:.1f} s"
        many = "1 scan does" if stretch["scans"] == 1 else f"{stretch['scans']} scans do"
        yield "untrusted", f"{when}: {many} not fit the map"
    if len(stretches) > _MAX_SEGMENTS:
        yield "untrusted", f"{len(stretches) - _MAX_SEGMENTS} more stretches, in report.json"
