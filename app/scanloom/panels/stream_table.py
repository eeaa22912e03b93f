"""The streams of a recording as HTML: counts, rates, gaps, possible commands, warnings."""

import html
from collections.abc import Iterable, Mapping
from typing import Any

from fusion_core.workflows.stream_gaps import GAP_RATIO_MIN, StreamGaps
from scanloom.page.markup import name_html
from scanloom.scene.duration_text import duration_text

_HEAD = "<th align='left' style='padding-right:0.5em;white-space:nowrap'>"
_NAME = "<td style='padding:0.1em 0.5em 0.1em 0;vertical-align:top'>"
_CELL = "<td style='padding:0.1em 0.5em 0.1em 0;vertical-align:top;white-space:nowrap'>"
_GAP_ROW = "<tr><td colspan='4' style='padding:0 0 0.2em 1em;vertical-align:top;font-style:italic'>"


def stream_table(described: Mapping[str, Any], gaps: Mapping[str, StreamGaps]) -> str:
    """``described``: the document of ``describe_recording``. ``gaps``: by topic."""
    rows = "".join(_row(topic) + _gap_row(gaps.get(topic["name"])) for topic in described["topics"])
    head = "".join(f"{_HEAD}{name}</th>" for name in ("stream", "role", "count", "Hz"))
    lines = [html.escape(line) for line in (*_about_gaps(gaps), *described["can"])]
    # Above the table: damage must be seen without scrolling.
    warnings = [f"<b>Warning:</b> {html.escape(line)}" for line in described["warnings"]]
    duration_s = described["duration_s"]
    time = "" if duration_s is None else f", {duration_text(duration_s)}"
    return (
        "<div style='padding:0 0.8em 0.5em;font-size:0.85em;overflow-wrap:anywhere'>"
        f"<div>{html.escape(described['format'])}{time}</div>"
        + _paragraphs(warnings)
        + f"<table class='scanloom-streams'><tr>{head}</tr>{rows}</table>"
        + _paragraphs(lines)
        + "</div>"
    )


def _paragraphs(lines: Iterable[str]) -> str:
    return "".join(f"<p style='margin:0.3em 0'>{line}</p>" for line in lines)


def _row(topic: Mapping[str, Any]) -> str:
    rate_hz = topic["rate_hz"]
    rate = "–" if rate_hz is None else f"{rate_hz:.1f}"
    cells = (topic["role"].replace("_", " "), f"{topic['count']:,}", rate)
    name = f"{_NAME}{name_html(topic['name'], is_broken=True)}</td>"
    return f"<tr>{name}{''.join(f'{_CELL}{cell}</td>' for cell in cells)}</tr>"


def _gap_row(found: StreamGaps | None) -> str:
    if found is None or not found.count:
        return ""
    count = "1 gap:" if found.count == 1 else f"{found.count:,} gaps, the longest"
    text = f"{count} {found.longest_s:.2f} s from {found.longest_at_s:.2f} s on"
    return f"{_GAP_ROW}{text}</td></tr>"


def _about_gaps(gaps: Mapping[str, StreamGaps]) -> list[str]:
    if not gaps:
        return []
    what = f"more than {GAP_RATIO_MIN:g} times the stream's usual interval"
    if any(found.count for found in gaps.values()):
        return [f"A gap is {what}, by log time."]
    return [f"No stream has a gap, which would be {what}."]
