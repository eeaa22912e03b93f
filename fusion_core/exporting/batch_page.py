"""The report of a batch as one HTML file that needs no other: no network, no server.

All names and messages are text of strangers: they are escaped, and the page's policy lets no script
run but its own.
"""

import base64
import hashlib
import html
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template

from fusion_core.exporting.palette import DEPTH
from fusion_core.exporting.small_multiples import (
    LINES_MAX,
    OUTLIER_COLOR,
    Chart,
    chart_html,
    key_html,
    outlier_key_html,
)

_FOLDER = Path(__file__).parent / "page_files"
_OUTLIER_LABEL = "differs from its rig"


@dataclass(frozen=True, slots=True, kw_only=True)
class PageCell:
    """``order``: what a number is sorted by, None for a text and where it is unknown."""

    text: str
    order: float | None = None
    title: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class PageColumn:
    label: str
    help: str
    is_number: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class PageRow:
    """``link``: opens it in a workbench that runs, "" where there is none."""

    cells: Sequence[PageCell]
    is_failed: bool
    flags: Sequence[str]
    command: str
    link: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Attention:
    """A recording to look at: ``title`` says what is the matter, ``reasons`` why."""

    name: str
    title: str
    reasons: Sequence[str]
    is_failed: bool
    command: str
    link: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchPage:
    """``facts``: label and value of each number at the top. ``constants``: what is not drawn since
    it does not vary. ``line_labels``: what each line of the charts belongs to, by its number.
    ``command_note``: where the commands are to be typed.
    """

    title: str
    facts: Sequence[tuple[str, str]]
    attention: Sequence[Attention]
    attention_left_out: int
    charts: Sequence[Chart]
    constants: Sequence[str]
    line_labels: Sequence[str]
    columns: Sequence[PageColumn]
    rows: Sequence[PageRow]
    rows_left_out: int
    notes: Sequence[str]
    command_note: str


def page_html(page: BatchPage) -> str:
    """The whole page."""
    style, script = (
        (_FOLDER / name).read_text(encoding="utf-8").strip() for name in ("batch.css", "batch.js")
    )
    digest = base64.b64encode(hashlib.sha256(f"\n{script}\n".encode()).digest()).decode()
    template = Template((_FOLDER / "batch.html").read_text(encoding="utf-8"))
    return template.substitute(
        title=html.escape(page.title),
        script_digest=digest,
        style=style.replace("FLAG_COLOR", OUTLIER_COLOR).replace("LINK_COLOR", DEPTH),
        script=script,
        facts="".join(
            f"<div><dt>{html.escape(label)}</dt><dd>{html.escape(value)}</dd></div>"
            for label, value in page.facts
        ),
        attention=_attention(page),
        legend=_legend(page),
        charts="".join(map(chart_html, page.charts)) or "<p>Nothing varies.</p>",
        constants=_constants(page),
        kinds="".join(
            f'<option value="{html.escape(kind)}">{html.escape(kind)}</option>'
            for kind in sorted({flag for row in page.rows for flag in row.flags})
        ),
        head="".join(map(_head, page.columns)),
        rows="\n".join(map(_row, page.rows)),
        count=len(page.rows),
        left_out=_left_out(page.rows_left_out),
        notes="".join(f"<li><bdi>{html.escape(note)}</bdi></li>" for note in page.notes),
        command_note=html.escape(page.command_note),
    )


def _attention(page: BatchPage) -> str:
    if not page.attention:
        return "<p>Nothing stands out.</p>"
    more = ""
    if page.attention_left_out:
        more = f"<p>{page.attention_left_out:,} more are marked in the table below.</p>"
    return f"<ol class='attention'>{''.join(map(_attention_item, page.attention))}</ol>{more}"


def _attention_item(item: Attention) -> str:
    kind = "failed" if item.is_failed else "flagged"
    reasons = "".join(f"<p><bdi>{html.escape(reason)}</bdi></p>" for reason in item.reasons)
    return (
        f'<li><h3><bdi>{html.escape(item.name)}</bdi> <span class="badge {kind}">'
        f"{html.escape(item.title)}</span></h3>{reasons}"
        f"<p>{_opening(item.command, item.link)}</p></li>"
    )


def _opening(command: str, link: str) -> str:
    code = f"<code>{html.escape(command)}</code>"
    if not link:
        return code
    return f'{code} <a href="{html.escape(link)}" rel="noreferrer">open</a>'


def _constants(page: BatchPage) -> str:
    if not page.constants:
        return ""
    return f'<p class="note">Equal in all: {html.escape("; ".join(page.constants))}.</p>'


def _legend(page: BatchPage) -> str:
    shown = page.line_labels[:LINES_MAX]
    keys = [key_html(label, number) for number, label in enumerate(shown)]
    if len(page.line_labels) > LINES_MAX:
        keys.append(key_html(f"{len(page.line_labels) - LINES_MAX} others", LINES_MAX))
    return "".join([*keys, outlier_key_html(_OUTLIER_LABEL)]) if page.charts else ""


def _head(column: PageColumn) -> str:
    kind = "number" if column.is_number else "text"
    return (
        f'<th scope="col" class="{kind}" aria-sort="none" title="{html.escape(column.help)}">'
        f"<button type='button'>{html.escape(column.label)}</button></th>"
    )


def _row(row: PageRow) -> str:
    state = "failed" if row.is_failed else "done"
    flags = html.escape("|".join(row.flags))
    cells = "".join(_cells(row))
    return f'<tr data-state="{state}" data-flags="{flags}">{cells}</tr>'


def _cells(row: PageRow) -> Iterator[str]:
    for place, cell in enumerate(row.cells):
        tag = 'th scope="row"' if place == 0 else "td"
        order = "" if cell.order is None else f' data-order="{cell.order!r}"'
        title = f' title="{html.escape(cell.title)}"' if cell.title else ""
        text = html.escape(cell.text)
        yield f"<{tag}{order}{title}><bdi>{text}</bdi></{tag.split()[0]}>"
    yield f"<td>{_opening(row.command, row.link)}</td>"


def _left_out(count: int) -> str:
    if count == 0:
        return ""
    return f"<p>{count:,} more recordings are in batch.parquet; these come first.</p>"
