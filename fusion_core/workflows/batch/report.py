"""What comes out of a batch: batch.parquet, a row for each recording, and report.html for people.

Rows are read one by one, and kept as columns: memory grows with the number of recordings, not with
their length.
"""

import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fusion_core.evaluation.fleet_quantities import FleetSettings
from fusion_core.exporting.batch_page import page_html
from fusion_core.exporting.settings_file import load_toml
from fusion_core.files.atomic import atomic_stream, write_text
from fusion_core.model.names import escape_undecodable
from fusion_core.model.progress import Progress, silent
from fusion_core.model.project import PROJECT
from fusion_core.workflows.batch.columns import Row, arrow_batch, arrow_schema
from fusion_core.workflows.batch.fleet_flags import (
    FlaggedRow,
    FleetTable,
    flagged_rows,
    settings_notes,
)
from fusion_core.workflows.batch.outcome import Outcome
from fusion_core.workflows.batch.report_page import build_page
from fusion_core.workflows.batch.rows import read_row
from fusion_core.workflows.batch.table_file import RECORDINGS_KEY, TABLE_NAME

if TYPE_CHECKING:
    import pyarrow as pa

REPORT_NAME = "report.html"
_RUNS = "runs"
# Rows that are held as dictionaries at a time.
_BLOCK_ROWS = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportSummary:
    """``flagged``: names of the recordings that differ from the others of their rig, the most
    urgent first. ``notes``: what was not compared."""

    table: Path
    report: Path
    recordings: int
    failed: int
    flagged: tuple[str, ...]
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """One machine-readable result."""
        return {
            "table": str(self.table),
            "report": str(self.report),
            "flagged": list(self.flagged),
            "notes": list(self.notes),
        }

    def lines(self) -> list[str]:
        """The same for people."""
        return [
            *(f"flagged     {name}" for name in self.flagged),
            f"table       {self.table}",
            f"report      {self.report}",
        ]


def load_fleet_settings(file: Path | None) -> FleetSettings:
    """The settings of the table [fleet] of a file, the defaults without one. Raises
    SettingsError."""
    base = FleetSettings()
    if file is None:
        return base
    loaded = load_toml(file, {"fleet": FleetSettings}, {"fleet": base})
    return FleetSettings.model_validate(loaded["fleet"].model_dump())


def write_report(
    folder: Path,
    outcomes: Sequence[Outcome],
    *,
    settings: FleetSettings | None = None,
    recordings: Path | None = None,
    link: Callable[[str], str] | None = None,
    progress: Progress = silent,
) -> ReportSummary:
    """Write ``folder``/batch.parquet and ``folder``/report.html.

    The results of each recording are read in ``folder``/runs/NAME. ``recordings``: the folder that
    all of them lie in, None where they lie in none; the table holds the way there from ``folder``.
    ``link``: the address that opens a recording in a workbench that runs; without it the report has
    no links.
    Raises ExportError where a file cannot be written.
    """
    settings = FleetSettings() if settings is None else settings
    fleet = FleetTable()
    blocks = list(_read_blocks(folder, outcomes, fleet, progress))
    found = fleet.compare(settings)
    flagged = flagged_rows(found)
    comparisons = int(np.isfinite(found.z).sum())
    notes = (*settings_notes(settings, comparisons), *found.notes)
    metadata = {
        "project": PROJECT,
        "notes": json.dumps(list(notes)),
        "fleet_settings": json.dumps(settings.model_dump(mode="json")),
    }
    if recordings is not None:
        metadata[RECORDINGS_KEY] = escape_undecodable(os.path.relpath(recordings, folder))
    table = _with_flags(blocks, flagged, metadata)
    _write_table(folder / TABLE_NAME, table)
    page = build_page(table, found, flagged, notes, link)
    write_text(folder / REPORT_NAME, page_html(page))
    names = table["name"]
    return ReportSummary(
        table=folder / TABLE_NAME,
        report=folder / REPORT_NAME,
        recordings=table.num_rows,
        failed=sum(state == "failed" for state in table["state"].to_pylist()),
        flagged=tuple(names[row.number].as_py() for row in flagged),
        notes=found.notes,
    )


def _read_blocks(
    folder: Path, outcomes: Sequence[Outcome], fleet: FleetTable, progress: Progress
) -> Iterator["pa.RecordBatch"]:
    rows: list[Row] = []
    for number, outcome in enumerate(outcomes, start=1):
        row = read_row(outcome, folder / _RUNS / outcome.name)
        fleet.add(row)
        rows.append(row)
        if len(rows) == _BLOCK_ROWS or number == len(outcomes):
            yield arrow_batch(rows, arrow_schema())
            rows = []
            progress(number, len(outcomes), "reading the results")


def _with_flags(
    blocks: list["pa.RecordBatch"], flagged: Sequence[FlaggedRow], metadata: dict[str, str]
) -> "pa.Table":
    """One table of all rows, with flags and reasons."""
    import pyarrow as pa

    schema = arrow_schema(metadata)
    table = pa.Table.from_batches(blocks, schema=arrow_schema())
    for name, texts in (
        ("flags", {row.number: row.kinds for row in flagged}),
        ("reasons", {row.number: row.reasons for row in flagged}),
    ):
        column = [list(texts.get(number, ())) for number in range(table.num_rows)]
        place = schema.get_field_index(name)
        table = table.set_column(
            place, schema.field(name), pa.array(column, schema.field(name).type)
        )
    return table.replace_schema_metadata(metadata)


def _write_table(path: Path, table: "pa.Table") -> None:
    import pyarrow.parquet as pq

    # A stream, since Arrow takes no path that is no UTF-8.
    with atomic_stream(path) as stream:
        pq.write_table(table, stream, compression="zstd")
