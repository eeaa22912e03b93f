"""report.html's content: what to look at first, charts over time, and the table of a batch."""

import shlex
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fusion_core.evaluation.fleet import FleetDeviations
from fusion_core.evaluation.fleet_quantities import QUANTITIES, Quantity
from fusion_core.exporting.batch_page import Attention, BatchPage, PageCell, PageColumn, PageRow
from fusion_core.exporting.small_multiples import Chart, ChartLine, ChartPoint
from fusion_core.model.conventions import FloatArray
from fusion_core.workflows.batch.columns import (
    UNKNOWN_TEXT,
    Column,
    Row,
    column_of,
    format_instant,
    format_with_deviation,
    shown_columns,
)
from fusion_core.workflows.batch.fleet_flags import FlaggedRow

if TYPE_CHECKING:
    import pyarrow as pa

# A browser sorts and filters so many without delay; batch.parquet holds them all.
ROWS_MAX = 5000
_ATTENTION_MAX = 50
_LIST_CHARACTERS_MAX = 200

Link = Callable[[str], str]


def build_page(
    table: "pa.Table",
    found: FleetDeviations,
    flagged: Sequence[FlaggedRow],
    notes: Sequence[str],
    link: Link | None,
) -> BatchPage:
    """The page of a batch's table, whose rows are in the order of ``found``."""
    failed = [n for n, state in enumerate(table["state"].to_pylist()) if state == "failed"]
    labels = _line_labels(table, found)
    varying = _varying(found)
    shown = _shown_rows(table.num_rows, [row.number for row in flagged], failed)
    columns = shown_columns(table)
    attention = list(_attention(table, flagged, failed, link))
    return BatchPage(
        title=f"Batch of {_commands(table)}, {_count(table.num_rows, 'recording')}",
        facts=_facts(table, len(flagged), len(failed)),
        attention=attention,
        attention_left_out=len(flagged) + len(failed) - len(attention),
        charts=list(_charts(table, found, labels, varying)),
        constants=list(_constants(found, varying)),
        line_labels=labels,
        columns=[_page_column(column) for column in columns],
        rows=[_page_row(row, columns, link) for row in _rows(table, shown)],
        rows_left_out=table.num_rows - len(shown),
        notes=notes,
        command_note="Commands are typed in the folder that all recordings of the batch lie in.",
    )


def view_command(row: Row) -> str:
    """The command that opens a recording, or that says what is wrong with one that failed."""
    recording = row["recording"]
    # A name that begins with a dash is no option.
    argument = shlex.quote(f"./{recording}" if recording.startswith("-") else recording)
    if row["state"] == "failed":
        return f"scanloom info {argument} --check"
    return f"scanloom view {argument}"


def _commands(table: "pa.Table") -> str:
    return ", ".join(sorted(set(table["command"].to_pylist()))) or "nothing"


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def _facts(table: "pa.Table", flagged: int, failed: int) -> list[tuple[str, str]]:
    import pyarrow.compute as pc

    facts = [
        ("done", f"{table.num_rows - failed:,}"),
        ("failed", f"{failed:,}"),
        ("flagged", f"{flagged:,}"),
    ]
    length_s = pc.sum(table["duration_s"]).as_py()
    if length_s is not None:
        facts.append(("recorded", _duration(length_s)))
    work_s = pc.sum(table["seconds"]).as_py()
    if work_s is not None:
        facts.append(("computing time", _duration(work_s)))
    return facts


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    minutes = seconds / 60.0
    return f"{minutes:.0f} min" if minutes < 120.0 else f"{minutes / 60.0:,.1f} h"


def _shown_rows(count: int, flagged: Sequence[int], failed: Sequence[int]) -> list[int]:
    """Which rows the table shows, in their order; of too many, those to look at first."""
    if count <= ROWS_MAX:
        return list(range(count))
    first = dict.fromkeys([*flagged, *failed, *range(count)])
    return sorted(list(first)[:ROWS_MAX])


def _rows(table: "pa.Table", numbers: Sequence[int]) -> Iterator[Row]:
    yield from table.take(np.array(numbers, dtype=np.int64)).to_pylist()


def _page_column(column: Column) -> PageColumn:
    return PageColumn(label=column.label, help=column.help, is_number=column.is_number)


def _page_row(row: Row, columns: Sequence[Column], link: Link | None) -> PageRow:
    is_failed = row["state"] == "failed"
    return PageRow(
        cells=[_cell(column, row) for column in columns],
        is_failed=is_failed,
        flags=row["flags"],
        command=view_command(row),
        link=link(row["recording"]) if link is not None and not is_failed else "",
    )


def _cell(column: Column, row: Row) -> PageCell:
    value = row[column.name]
    text = format_with_deviation(column, row)
    if column.is_number or column.show == "instant":
        return PageCell(text=text, order=None if value is None else float(value))
    title = {"name": row["recording"], "flags": "\n".join(row["reasons"])}.get(column.name, "")
    if column.name == "error" and value is not None:
        title = f"{value} {row['advice'] or ''}".strip()
    if len(text) > _LIST_CHARACTERS_MAX:
        title, text = title or text, f"{text[:_LIST_CHARACTERS_MAX]} …"
    return PageCell(text=text, title=title)


def _attention(
    table: "pa.Table", flagged: Sequence[FlaggedRow], failed: Sequence[int], link: Link | None
) -> Iterator[Attention]:
    """The flagged recordings, then the failed ones; of each kind no more than its half, unless
    the other kind leaves room."""
    half = _ATTENTION_MAX // 2
    flagged = flagged[: max(half, _ATTENTION_MAX - len(failed))]
    failed = failed[: max(half, _ATTENTION_MAX - len(flagged))]
    for found, row in zip(flagged, _rows(table, [one.number for one in flagged]), strict=True):
        yield Attention(
            name=row["name"],
            title=", ".join(found.kinds),
            reasons=found.reasons,
            is_failed=False,
            command=view_command(row),
            link="" if link is None else link(row["recording"]),
        )
    for row in _rows(table, failed):
        yield Attention(
            name=row["name"],
            title="failed",
            reasons=[text for text in (row["error"], row["advice"]) if text],
            is_failed=True,
            command=view_command(row),
        )


def _line_labels(table: "pa.Table", found: FleetDeviations) -> list[str]:
    """The robots of the batch, those with the most recordings first; a rig without a robot is
    named for its sensors."""
    is_known = [bool(np.isfinite(values).any()) for values in found.values]
    counts = dict.fromkeys(_line_of_rows(table, found), 0)
    for label, known in zip(_line_of_rows(table, found), is_known, strict=True):
        counts[label] += int(known)
    return sorted(filter(counts.get, counts), key=lambda label: (-counts[label], label))


def _line_of_rows(table: "pa.Table", found: FleetDeviations) -> list[str]:
    robots = table["robot"].to_pylist()
    return [
        robot or found.rig_labels[rig]
        for robot, rig in zip(robots, found.rig.tolist(), strict=True)
    ]


def _varying(found: FleetDeviations) -> list[int]:
    """The quantities with more than one value."""
    columns = range(len(QUANTITIES))
    return [n for n in columns if np.unique(_finite(found.values[:, n])).size > 1]


def _finite(values: FloatArray) -> FloatArray:
    return values[np.isfinite(values)]


def _constants(found: FleetDeviations, varying: Sequence[int]) -> Iterator[str]:
    for place, quantity in enumerate(QUANTITIES):
        values = _finite(found.values[:, place])
        if place not in varying and values.size:
            column = column_of(quantity.name)
            yield f"{quantity.label} {column.format(values[0])} {column.shown_unit}".strip()


def _charts(
    table: "pa.Table", found: FleetDeviations, labels: Sequence[str], varying: Sequence[int]
) -> Iterator[Chart]:
    """A chart for each quantity that varies."""
    number_of = {label: number for number, label in enumerate(labels)}
    # Of what has no values no line is drawn.
    line_of_rows = _line_of_rows(table, found)
    lines = np.array([number_of.get(label, -1) for label in line_of_rows], dtype=np.int64)
    names = table["name"].to_pylist()
    x, x_labels = _axis(table)
    for place in varying:
        known = np.flatnonzero(np.isfinite(found.values[:, place]) & np.isfinite(x))
        order = known[np.argsort(x[known], kind="stable")]
        if not order.size:
            continue
        yield Chart(
            title=_chart_title(QUANTITIES[place]),
            x_ends=(float(np.nanmin(x)), float(np.nanmax(x))),
            x_labels=x_labels,
            lines=[
                ChartLine(
                    number=int(line),
                    points=[
                        _point(n, place, float(x[n]), names, found)
                        for n in order[lines[order] == line].tolist()
                    ],
                )
                for line in np.unique(lines[order])
            ],
        )


def _chart_title(quantity: Quantity) -> str:
    unit = column_of(quantity.name).shown_unit
    title = quantity.label[0].upper() + quantity.label[1:]
    return f"{title}, {unit}" if unit else title


def _point(
    number: int, place: int, x: float, names: Sequence[str], found: FleetDeviations
) -> ChartPoint:
    column = column_of(QUANTITIES[place].name)
    value = float(found.values[number, place])
    return ChartPoint(
        x=x,
        y=column.shown_number(value),
        name=names[number],
        value=f"{column.format(value)} {column.shown_unit}".strip(),
        is_outlier=bool(found.is_flagged[number, place]),
    )


def _axis(table: "pa.Table") -> tuple[Any, tuple[str, str]]:
    """(N,) where each recording lies on the axis, NaN where unknown, and the labels of its ends:
    the starts of the recordings, or their order in the table where these do not tell them apart."""
    starts = table["start_ns"].to_numpy()
    known = starts[~np.isnan(starts.astype(np.float64))]
    if known.size and np.unique(known).size > known.size // 2:
        first, last = int(known.min()), int(known.max())
        ends = format_instant(first), format_instant(last)
        # Differences first: nanoseconds since 1970 have more digits than a float.
        return starts.astype(np.float64) - float(first), _short(*ends)
    return np.arange(table.num_rows, dtype=np.float64), ("first of the list", "last")


def _short(first: str, last: str) -> tuple[str, str]:
    """Without the time of day where the days differ."""
    if UNKNOWN_TEXT not in first + last and first[:10] != last[:10] and "-" in first:
        return first[:10], last[:10]
    return first, last
