"""Maps as pictures for people: colours that the colour-blind can tell apart, and a scale bar."""

from pathlib import Path

import cv2
import numpy as np

from fusion_core.files.atomic import write_bytes
from fusion_core.model.conventions import ByteArray
from fusion_core.model.errors import ExportError
from fusion_core.model.grids import MapDifference, OccupancyGrid

Color = tuple[int, int, int]

# Okabe & Ito 2008, distinguishable by deuteranopes and protanopes, darkest for what all maps
# share. By the bit mask of MapDifference, for two and for three maps.
_OBSTACLES: dict[int, tuple[Color, ...]] = {
    2: ((0, 114, 178), (213, 94, 0), (0, 0, 0)),
    3: (
        (0, 114, 178),  # first
        (213, 94, 0),  # second
        (204, 121, 167),  # first and second
        (240, 228, 66),  # third
        (86, 180, 233),  # first and third
        (230, 159, 0),  # second and third
        (0, 0, 0),  # all
    ),
}
UNKNOWN: Color = (196, 204, 214)
FREE: Color = (255, 255, 255)
# A probability of one half.
_UNCONFIRMED: Color = (128, 128, 128)
_FOREGROUND: Color = (0, 0, 0)
_BACKGROUND: Color = (255, 255, 255)

_LONGEST_SIDE_PX = 800
_ZOOM_MAX = 16
_WIDTH_MIN_PX = 360
_MARGIN_PX = 12
_LINE_PX = 22
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_FONT_SCALE = 0.45


def write_grid_picture(path: Path, grid: OccupancyGrid) -> None:
    """A map: the darker a cell, the more probable an obstacle; unknown cells are blue-grey, and
    middle grey those of which only unconfirmed returns are known."""
    rgb = np.empty((*grid.log_odds.shape, 3), dtype=np.uint8)
    # Row by row: a large map's arrays of floats would be several times the map.
    for row, log_odds in zip(rgb, grid.log_odds, strict=True):
        known = np.isfinite(log_odds)
        occupied = 1.0 / (1.0 + np.exp(-log_odds[known]))
        row[known] = np.round(255.0 * (1.0 - occupied)).astype(np.uint8)[:, np.newaxis]
        row[~known] = UNKNOWN
    legend = [((0, 0, 0), "occupied"), (FREE, "free"), (UNKNOWN, "unknown")]
    if (grid.log_odds == 0.0).any():
        legend.append((_UNCONFIRMED, "not confirmed"))
    _write(path, _compose(rgb, grid.resolution_m, legend))


def write_difference_picture(path: Path, difference: MapDifference) -> None:
    """The difference of two or three maps, each state in its colour."""
    colors = difference_colors(len(difference.names))
    rgb = np.array(colors, dtype=np.uint8)[difference.states]
    legend = [(colors[state], label) for state, label in difference.legend.items()]
    _write(path, _compose(rgb, difference.resolution_m, legend))


def difference_colors(maps: int) -> tuple[Color, ...]:
    """The colour of each state of a MapDifference of two or three maps."""
    return (UNKNOWN, FREE, *_OBSTACLES[maps])


def scale_bar_m(width_m: float) -> float:
    """The longest of 1, 2 or 5 times a power of ten that is at most a third of a width."""
    longest_m = width_m / 3.0
    power = 10.0 ** np.floor(np.log10(longest_m))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= longest_m))


def _compose(rgb: ByteArray, resolution_m: float, legend: list[tuple[Color, str]]) -> ByteArray:
    """The map enlarged with y upwards, and below it the scale bar and the legend."""
    zoom = int(np.clip(_LONGEST_SIDE_PX // max(rgb.shape[:2]), 1, _ZOOM_MAX))
    cells = np.flipud(rgb).repeat(zoom, axis=0).repeat(zoom, axis=1)
    height, width = cells.shape[:2]
    top = height + 2 * _MARGIN_PX
    canvas_shape = (
        top + _LINE_PX * (1 + len(legend)),
        max(width + 2 * _MARGIN_PX, _WIDTH_MIN_PX),
        3,
    )
    canvas = np.full(canvas_shape, _BACKGROUND, dtype=np.uint8)
    canvas[_MARGIN_PX : _MARGIN_PX + height, _MARGIN_PX : _MARGIN_PX + width] = cells

    bar_m = scale_bar_m(canvas_shape[1] / zoom * resolution_m)
    bar_px = round(bar_m / resolution_m * zoom)
    cv2.rectangle(
        canvas, (_MARGIN_PX, top + 4), (_MARGIN_PX + bar_px - 1, top + 9), _FOREGROUND, -1
    )
    _put_text(canvas, f"{bar_m:g} m", _MARGIN_PX + bar_px + 8, top + 11)
    for i, (color, label) in enumerate(legend):
        y = top + _LINE_PX * (i + 1)
        cv2.rectangle(canvas, (_MARGIN_PX, y), (_MARGIN_PX + 14, y + 14), color, -1)
        cv2.rectangle(canvas, (_MARGIN_PX, y), (_MARGIN_PX + 14, y + 14), _FOREGROUND, 1)
        _put_text(canvas, label, _MARGIN_PX + 24, y + 12)
    return canvas


def _put_text(canvas: ByteArray, text: str, x: int, y: int) -> None:
    cv2.putText(canvas, text, (x, y), _FONT, _FONT_SCALE, _FOREGROUND, 1, cv2.LINE_AA)


def _write(path: Path, rgb: ByteArray) -> None:
    done, png = cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    if not done:
        raise ExportError("cannot be encoded as PNG.", file=path)
    write_bytes(path, png.tobytes())
