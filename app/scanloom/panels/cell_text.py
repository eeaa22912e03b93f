"""What is known of one cell of a run's grids, as HTML."""

import html
import math
from collections.abc import Mapping, Sequence

from fusion_core.model.grid_fusion import CellEvidence, CellState
from fusion_core.model.grids import OccupancyGrid
from scanloom.page.markup import paragraph
from scanloom.panels.swatches import css_color
from scanloom.scene.map_nodes import DIFFERING_COLOR

# Of the states; "free" is the word of the page for what Fu 2024 calls empty.
_WORDS = {CellState.UNKNOWN: "unknown", CellState.EMPTY: "free", CellState.OCCUPIED: "occupied"}
_CELL = "padding:0.15em 0.9em 0.15em 0;text-align:left;font-weight:inherit"
CLICK = "Click the map for what is known of a cell."


def differing_html(cells: int) -> str:
    """How many cells the two rules of fusion decide differently, and how the map marks them."""
    color = css_color(DIFFERING_COLOR)
    many = "1 cell is" if cells == 1 else f"{cells} cells are"
    return (
        '<div style="padding:0.2em 0.8em;font-size:0.85em">'
        f"{many} another by Table 3 than by Bayes' rule (10): "
        f'<b style="color:{color}">outlined</b> on the map.</div>'
    )


def evidence_html(evidence: CellEvidence) -> str:
    """Both grids' states, probabilities and log odds of a cell, and what each rule makes of them
    (Fu 2024, Table 3 and (10))."""
    rows = [
        (name, _WORDS[state], evidence.probabilities[name], evidence.log_odds[name])
        for name, state in evidence.states.items()
    ]
    rows.append(
        (
            "by Table 3",
            _WORDS[evidence.table_state],
            _probability(evidence.table_log_odds),
            evidence.table_log_odds,
        )
    )
    rows.append(
        (
            "by (10)",
            _WORDS[evidence.bayes_state],
            evidence.bayes_probability,
            evidence.bayes_log_odds,
        )
    )
    x_m, y_m = evidence.centre_m
    differ = ""
    if evidence.table_state != evidence.bayes_state:
        differ = paragraph(
            "The rules differ: by Table 3 an obstacle of either grid stays, by (10) the stronger "
            "evidence decides."
        )
    head = ("", "state", "P", "log odds")
    return _heading(x_m, y_m) + _table(head, [_row(*row) for row in rows]) + differ


def states_html(states: Mapping[str, OccupancyGrid], x_m: float, y_m: float) -> str:
    """The state of the cell at a place in each grid by name; of these no more is known."""
    rows = [(name, _WORDS[cell_state(grid, x_m, y_m)]) for name, grid in states.items()]
    return _heading(x_m, y_m) + _table(("", "state"), rows)


def cell_state(grid: OccupancyGrid, x_m: float, y_m: float) -> CellState:
    """The state of the cell at a place; unknown outside of the grid."""
    column = math.floor((x_m - grid.origin_m[0]) / grid.resolution_m)
    row = math.floor((y_m - grid.origin_m[1]) / grid.resolution_m)
    rows, columns = grid.log_odds.shape
    if not (0 <= row < rows and 0 <= column < columns):
        return CellState.UNKNOWN
    log_odds = float(grid.log_odds[row, column])
    if log_odds > 0.0:
        return CellState.OCCUPIED
    return CellState.EMPTY if log_odds < 0.0 else CellState.UNKNOWN


def _probability(log_odds: float) -> float:
    return 1.0 / (1.0 + math.exp(-log_odds)) if math.isfinite(log_odds) else math.nan


def _row(name: str, state: str, probability: float, log_odds: float) -> tuple[str, ...]:
    def known(value: float, digits: str) -> str:
        return format(value, digits) if math.isfinite(value) else "–"

    return name, state, known(probability, ".3f"), known(log_odds, "+.2f")


def _heading(x_m: float, y_m: float) -> str:
    return paragraph(f"Cell at x = {x_m:.3f} m, y = {y_m:.3f} m")


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    def line(cells: tuple[str, ...], tag: str) -> str:
        return "".join(f"<{tag} style='{_CELL}'>{html.escape(cell)}</{tag}>" for cell in cells)

    body = "".join(f"<tr>{line(row, 'td')}</tr>" for row in rows)
    return (
        "<table style='margin:0 0.5em;font-size:0.85em;border-collapse:collapse'>"
        f"<tr style='opacity:0.7'>{line(head, 'th')}</tr>{body}</table>"
    )
