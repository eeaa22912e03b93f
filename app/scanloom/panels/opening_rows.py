"""What the opening dialog lists: places, a page of a folder, or a page of a batch."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from fusion_core.model.conventions import IntArray
from fusion_core.model.errors import ExportError
from fusion_core.workflows.batch.columns import Row
from scanloom.panels.opening_html import OpeningRow
from scanloom.state.batch_list import BatchList, BatchOrder
from scanloom.state.folder_listing import PAGE_ROWS, FolderPage, FolderPlace, read_page
from scanloom.state.library import Library

_NO_NAME = "Its name cannot be told from another's: rename it."
_ELSEWHERE = (
    "It is not below a folder of this server: start scanloom view with its folder as --root, too."
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BatchPage:
    """A page of a batch's list: ``numbers`` are the rows of the whole list, as sorted; ``rows``
    those of the page."""

    batch: BatchList
    order: BatchOrder
    numbers: IntArray
    rows: tuple[Row, ...]


def folder_rows(
    library: Library, place: FolderPlace, check: Callable[[], None]
) -> tuple[FolderPage, list[OpeningRow]]:
    """A page of a folder. ``check`` is called for each name and may raise to end it."""
    page = read_page(place, check)
    rows = [
        OpeningRow(
            label=row.label,
            name=(name := library.name_of(row.path) if row.is_recording else None),
            path=row.path,
            is_recording=row.is_recording,
            can_enter=row.is_folder,
            problem="" if name or not row.is_recording else _NO_NAME,
        )
        for row in page.rows
    ]
    return page, rows


class BatchReader:
    """Reads the lists of batches, sorted by what was asked for last; the last list is kept."""

    def __init__(self, library: Library) -> None:
        self._library = library
        self._batch: BatchList | None = None
        self._order = BatchOrder()

    def sort(self, column: str) -> None:
        """Sort by a column from now on; by the one it is sorted by already, the other way round."""
        self._order = self._order.by(column)

    def read(self, place: FolderPlace) -> tuple[FolderPage, list[OpeningRow], BatchPage | None]:
        """A page of the batch in a folder. The last is None where its table cannot be read."""
        batch = self._batch
        try:
            if batch is None or batch.folder != place.folder or batch.is_outdated:
                batch = self._batch = BatchList(place.folder)
        except ExportError as error:
            return FolderPage(problem=f"{error.problem} {error.advice}"), [], None
        numbers = batch.numbers(self._order, place.find)
        shown = numbers[place.start : place.start + PAGE_ROWS].tolist()
        rows = batch.rows(shown)
        names = [batch.name_in(self._library, number) for number in shown]
        opening = [
            OpeningRow(
                label=row["name"],
                name=name,
                is_recording=True,
                problem="" if name is not None else _ELSEWHERE,
            )
            for row, name in zip(rows, names, strict=True)
        ]
        end = place.start + len(rows)
        page = FolderPage(
            next_start=end if end < numbers.size else None,
            count=int(numbers.size),
            problem=f"{numbers.size:,} of {batch.count:,} recordings: ◆ flagged, ✕ failed.",
        )
        return (
            page,
            opening,
            BatchPage(batch=batch, order=self._order, numbers=numbers, rows=tuple(rows)),
        )


def place_rows(
    library: Library, labels: Iterable[tuple[str, str, Path | None]]
) -> list[OpeningRow]:
    """The list of places: recordings by name, label and path, and the roots."""
    rows = [
        OpeningRow(label=label, name=name, path=path, is_recording=True)
        for name, label, path in labels
    ]
    return rows + [
        OpeningRow(label=library.root_label(root), path=root, can_enter=True)
        for root in library.roots
    ]
