"""The list of a batch in the opening dialog, and the way through it, as HTML. All texts are
escaped."""

import html
from collections.abc import Sequence

from fusion_core.model.names import printable
from fusion_core.workflows.batch.columns import Column, Row, format_with_deviation
from scanloom.page.bridge import press_attributes
from scanloom.page.markup import name_html
from scanloom.panels.opening_html import OpeningRow
from scanloom.state.batch_list import BatchOrder

# Longer lists of warnings are told whole by the title.
_MAX_CHARACTERS = 60


def batch_html(
    columns: Sequence[Column],
    order: BatchOrder,
    listed: Sequence[tuple[Row, OpeningRow]],
    serial: int,
) -> str:
    """A table of the rows; each name opens its recording, each heading sorts."""
    head = "".join(_head(column, order) for column in columns)
    rows = "".join(
        _row(columns, row, opening, f"{serial}.{index}")
        for index, (row, opening) in enumerate(listed)
    )
    return (
        '<div class="scanloom-open scanloom-batch" tabindex="0" role="region" '
        'aria-label="Recordings of the batch">'
        f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>"
    )


def walk_html(name: str, place: int, count: int) -> str:
    """Where one is in the list of a batch, and the buttons to the recordings before and after."""
    previous, following = "Previous recording of the batch", "Next recording of the batch"
    return (
        '<nav class="scanloom-walk" aria-label="Batch">'
        f"<button {press_attributes('batch-step', '-1')} title='{previous} (Shift + PageUp)' "
        f"aria-label='{previous}'>◂</button>"
        f"<span>{name_html(name)} {place + 1:,} of {count:,}</span>"
        f"<button {press_attributes('batch-step', '1')} title='{following} (Shift + PageDown)' "
        f"aria-label='{following}'>▸</button></nav>"
    )


def _head(column: Column, order: BatchOrder) -> str:
    sort, mark = "none", ""
    if column.name == order.column:
        sort = "descending" if order.is_descending else "ascending"
        mark = "▼" if order.is_descending else "▲"
    kind = ' class="number"' if column.is_number else ""
    label, about = html.escape(column.label), html.escape(column.help)
    return (
        f'<th scope="col" aria-sort="{sort}"{kind}>'
        f'<button {press_attributes("batch-sort", column.name)} title="{about}">'
        f"{label} <i>{mark}</i></button></th>"
    )


def _row(columns: Sequence[Column], row: Row, opening: OpeningRow, token: str) -> str:
    cells = "".join(_cell(column, row) for column in columns if column.name != "name")
    mark = "✕ " if row["state"] == "failed" else "◆ " if row["flags"] else ""
    label = f"{mark}{name_html(opening.label)}"
    if opening.name is None:
        first = f'<span title="{html.escape(opening.problem)}">{label}</span>'
    else:
        first = f"<button {press_attributes('open-file', token)}>{label}</button>"
    return f'<tr data-state="{html.escape(row["state"])}"><th scope="row">{first}</th>{cells}</tr>'


def _cell(column: Column, row: Row) -> str:
    text = whole = printable(format_with_deviation(column, row))
    if column.name == "flags":
        whole = "\n".join(row["reasons"])
    elif column.name == "error" and row["advice"]:
        whole = f"{text} {row['advice']}"
    if len(text) > _MAX_CHARACTERS:
        text = f"{text[:_MAX_CHARACTERS]}…"
    title = f' title="{html.escape(whole)}"' if whole != text else ""
    kind = ' class="number"' if column.is_number else ""
    return f"<td{kind}{title}><bdi>{html.escape(text)}</bdi></td>"
