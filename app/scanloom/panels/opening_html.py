"""The opening dialog's rows, places and messages as HTML. All names are text: they are escaped,
isolated from the direction of writing around them, and shortened."""

import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fusion_core.model.names import printable
from scanloom.page.bridge import press_attributes
from scanloom.page.markup import name_html
from scanloom.scene.duration_text import duration_text
from scanloom.state.folder_listing import FolderPage
from scanloom.state.recording_details import RecordingDetails

_FOLDER = (
    '<svg width="16" height="14" viewBox="0 0 16 14" aria-hidden="true" fill="currentColor">'
    '<path d="M1 1h5l2 2h7v10H1z" opacity="0.6"/></svg>'
)
READING_HTML = '<div class="scanloom-open scanloom-pages"><span>Looking through it …</span></div>'


@dataclass(frozen=True, slots=True, kw_only=True)
class OpeningRow:
    """A row of the dialog. ``name``: by which the library opens it, None if it is no recording or
    cannot be opened; ``problem`` says why. ``can_enter``: it is a folder."""

    label: str
    name: str | None = None
    path: Path | None = None
    is_recording: bool = False
    can_enter: bool = False
    problem: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class OpeningStatus:
    """What goes on, or why the last choice failed. ``percent``: None where it is not known."""

    kind: Literal["opening", "uploading", "failed"]
    text: str
    percent: float | None = None


def status_html(status: OpeningStatus | None) -> str:
    """A line about what goes on, with a button to end it."""
    if status is None:
        return ""
    is_failure = status.kind == "failed"
    name, label = ("open-dismiss", "Dismiss") if is_failure else ("open-cancel", "Cancel")
    bar = ""
    if not is_failure:
        value = "" if status.percent is None else f' value="{status.percent:.0f}" max="100"'
        bar = f"<progress{value}></progress>"
    return (
        f'<div class="scanloom-open scanloom-status" data-kind="{status.kind}" role="status">'
        f"<span>{html.escape(printable(status.text))}</span>{bar}"
        f"<button {press_attributes(name)}>{label}</button></div>"
    )


def recent_html(names: Sequence[str], serial: int) -> str:
    """The recordings opened last."""
    buttons = "".join(
        f"<button {press_attributes('open-recent', f'{serial}.{index}')}>{name_html(name)}</button>"
        for index, name in enumerate(names)
    )
    row = f'<div class="scanloom-open scanloom-recent"><span>Recent</span>{buttons}</div>'
    return row if names else ""


def places_html(parts: Sequence[str]) -> str:
    """Where one is: buttons to all folders above. The first part is the list of places."""
    links = []
    for depth, part in enumerate(parts):
        last = depth == len(parts) - 1
        label = name_html(part)
        links.append(
            f'<b aria-current="page">{label}</b>'
            if last
            else f"<button {press_attributes('open-place', str(depth))}>{label}</button>"
        )
    up = ""
    if len(parts) > 1:
        up = f"<button {press_attributes('open-place', str(len(parts) - 2))}>↑ Up</button>"
    inner = up + " / ".join(links)
    return f'<nav class="scanloom-open scanloom-places" aria-label="Folders">{inner}</nav>'


def rows_html(
    rows: Sequence[OpeningRow], details: Sequence[RecordingDetails | None], serial: int
) -> str:
    """The rows; ``details``: of each, None where they are not known yet or it is no recording."""
    lines = (
        _row_html(row, about, f"{serial}.{index}")
        for index, (row, about) in enumerate(zip(rows, details, strict=True))
    )
    return f'<ul class="scanloom-open scanloom-files">{"".join(lines)}</ul>'


def pages_html(start: int, page: FolderPage) -> str:
    """Which names of a folder were looked at, and buttons to the pages before and after."""
    said = [page.problem] if page.problem else []
    if page.left_out == 1:
        said.append("1 other is no recording.")
    elif page.left_out:
        said.append(f"{page.left_out:,} others are no recordings.")
    has_next = page.next_start is not None
    if start or has_next:
        end = page.count if page.next_start is None else page.next_start
        said.append(f"Names {start + 1:,} to {end:,} of {page.count:,}.")
    elif not page.rows and not page.problem:
        said.append("No recordings here.")
    buttons = ""
    if start:
        buttons += f"<button {press_attributes('open-page', 'previous')}>Previous</button>"
    if has_next:
        buttons += f"<button {press_attributes('open-page', 'next')}>Next</button>"
    text = html.escape(" ".join(said))
    return f'<div class="scanloom-open scanloom-pages"><span>{text}</span>{buttons}</div>'


def upload_html(limit_bytes: int) -> str:
    """The buttons that choose a file of the browser's machine, and that close the dialog."""
    close = f'<button {press_attributes("open-close")} class="scanloom-close">Close</button>'
    if limit_bytes == 0:
        return f'<div class="scanloom-open scanloom-upload">{close}</div>'
    return (
        '<div class="scanloom-open scanloom-upload"><label>'
        '<input type="file" data-upload-file>'
        '<span class="scanloom-upload-choose">Upload a file…</span></label> '
        "or drop it on the page: at most "
        f"{limit_bytes / 1e6:,.0f} MB, kept until this page is closed.{close}</div>"
    )


def _row_html(row: OpeningRow, details: RecordingDetails | None, token: str) -> str:
    label = name_html(row.label)
    problem = row.problem or ("" if details is None else details.problem)
    enter = f"<button {press_attributes('open-folder', token)}"
    if not row.is_recording:
        return f"<li>{enter}>{_FOLDER} {label}<small>folder</small></button></li>"
    if problem:
        about = html.escape(printable(problem))
        main = f'<div class="scanloom-bad" aria-disabled="true">{label}<small>{about}</small></div>'
    else:
        about = "…" if details is None else html.escape(printable(_details_text(details)))
        main = (
            f"<button {press_attributes('open-file', token)}>{label}<small>{about}</small></button>"
        )
    inside = f'{enter} class="scanloom-into" title="Look inside">{_FOLDER}</button>'
    return f"<li>{main}{inside if row.can_enter else ''}</li>"


def _details_text(details: RecordingDetails) -> str:
    streams = ", ".join(details.streams) or "no LiDAR, depth or odometry"
    parts = [details.format]
    if details.duration_s is not None:
        parts.append(duration_text(details.duration_s))
    if details.duration_s is not None or details.streams:
        parts.append(streams)
    parts.append(_size_text(details.size_bytes))
    return " · ".join(parts)


def _size_text(size_bytes: int) -> str:
    if size_bytes >= 1_000_000_000:
        return f"{size_bytes / 1e9:.1f} GB"
    return f"{size_bytes / 1e6:.1f} MB" if size_bytes >= 100_000 else f"{size_bytes / 1e3:.1f} kB"


def index_of(token: str, serial: int, count: int) -> int | None:
    """The place in a list of a button's token, None if it is of another list or of none."""
    of, _, index = token.partition(".")
    if of != str(serial) or not index.isdecimal() or len(index) > 4 or int(index) >= count:
        return None
    return int(index)
