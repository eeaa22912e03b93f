"""The chain over many rooms of a data set, and Table 1 of Xu 2024 over them."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fusion_core.exporting.manifest import MANIFEST_NAME
from fusion_core.files.inputs import require_apart
from fusion_core.model.errors import ExportError, RecordingError, ScanLoomError
from fusion_core.model.progress import Progress, silent
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions
from fusion_core.workflows.fuse.table_1 import (
    TABLE_1_COLUMNS,
    is_table_1,
    table_1_row,
    write_table_1,
)
from fusion_core.workflows.source import room_choices, rooms_of

_TABLE_NAME = "table1.csv"


@dataclass(frozen=True, kw_only=True)
class RoomsSummary:
    """The result of each room: rows of Table 1, and why other rooms were left out."""

    output: Path
    rows: tuple[dict[str, Any], ...]
    failed: dict[str, str]

    def to_json(self) -> dict[str, Any]:
        """One machine-readable result."""
        return {"output": str(self.output), "table_1": list(self.rows), "failed": self.failed}

    def lines(self) -> list[str]:
        """Table 1 for people, and what is left out."""
        cells = [list(TABLE_1_COLUMNS)]
        cells += [[str(row[column]) for column in TABLE_1_COLUMNS] for row in self.rows]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in cells
        ]
        lines += [f"left out   {room}: {reason}" for room, reason in self.failed.items()]
        return [*lines, f"results    {self.output}"]


def fuse_rooms(
    root: Path,
    session: str | None,
    output: Path,
    options: FuseOptions,
    progress: Progress = silent,
) -> RoomsSummary:
    """Fuse every room of a data set, or of one session, each into a folder of its own.

    A room that cannot be fused is named and left out. Raises RecordingError where there is no room
    or none can be fused, ExportError for an output inside of the data set, or with results of one
    run.
    """
    _check_output(root, output)
    choices = list(room_choices(rooms_of(root, session)))
    rows = []
    failed: dict[str, str] = {}
    for number, choice in enumerate(choices, start=1):

        def in_room(
            done: int,
            total: int | None,
            what: str,
            heading: str = f"{number}/{len(choices)} {choice}",
        ) -> None:
            progress(done, total, f"{heading}: {what}")

        try:
            summary = fuse(root, output / str(choice), replace(options, room=choice), in_room)
        except ScanLoomError as error:
            failed[str(choice)] = error.problem
            continue
        rows.append(table_1_row(str(choice), summary.scores))
    if not rows:
        first = next(iter(failed.values()))
        raise RecordingError(
            f"none of its {len(choices)} rooms can be fused; the first: {first}",
            file=root,
            advice="Look into a room with info ROOT --home SESSION --room ROOM.",
        )
    write_table_1(output / _TABLE_NAME, rows)
    return RoomsSummary(output=output, rows=tuple(rows), failed=failed)


def _check_output(root: Path, output: Path) -> None:
    require_apart(output, [root])
    table = output / _TABLE_NAME
    if (output / MANIFEST_NAME).exists() or (table.exists() and not is_table_1(table)):
        raise ExportError(
            "holds files that are not rooms of a session.",
            file=output,
            advice="Name another output folder.",
        )
