"""Table 1 of Xu 2024: how many frames of a room score low, middle and high."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from fusion_core.alignment.search import Peak
from fusion_core.exporting.tables import CsvTable

TABLE_1_COLUMNS = (
    "room",
    "low",
    "middle",
    "high",
    "high_percent",
    "not_positive",
    "missing",
)


def score_range(peak: Peak | None) -> str:
    """The column of Table 1 for a frame's greatest Pearson score."""
    if peak is None:
        return "missing"
    if peak.score <= 0.0:
        return "not_positive"
    if peak.score <= 0.3:
        return "low"
    return "middle" if peak.score <= 0.6 else "high"


def table_1_row(room: str, scores: dict[str, int]) -> dict[str, Any]:
    """A row of Table 1: frames by their own greatest Pearson score."""
    scored = scores["low"] + scores["middle"] + scores["high"]
    high_percent = 100.0 * scores["high"] / scored if scored else float("nan")
    return {"room": room, "high_percent": round(high_percent, 2), **scores}


def write_table_1(path: Path, rows: Iterable[dict[str, Any]]) -> None:
    """Table 1 of one or more rooms as CSV."""
    with CsvTable(path, TABLE_1_COLUMNS) as table:
        for row in rows:
            table.append(row)


def is_table_1(path: Path) -> bool:
    """Whether a file begins as Table 1 does."""
    head = ",".join(TABLE_1_COLUMNS).encode()
    with path.open("rb") as stream:
        return stream.read(len(head)) == head
