"""Small line charts as SVG, for pages that hold no other file. Outliers differ in shape and colour.

Colours are those of the figures: each has a contrast of at least 3 : 1 to a light and a dark page.
"""

import html
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor, log10

from fusion_core.exporting.palette import BURR, CONFLICT, DEPTH, GOOD, LIDAR

OUTLIER_COLOR = BURR
_WIDTH, _HEIGHT = 340.0, 150.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 50.0, 12.0, 10.0, 20.0
_TICKS_MAX = 5
# More points than pixels show nothing more: of each pixel's the lowest and the highest are drawn.
_BINS = 300
_POINTS_MAX = 2 * _BINS
_DOT, _DIAMOND = 2.2, 5.5
# Names on the points of a long list would be most of the page.
_NAMED_POINTS_MAX = 200
_LOOKS = tuple(
    (color, dash) for dash in ("", "6 3", "2 3") for color in (DEPTH, LIDAR, GOOD, CONFLICT)
)
LINES_MAX = len(_LOOKS)
"""Lines that can be told from each other; the others are grey."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartPoint:
    """``name``: of what was measured; ``value``: as text with its unit."""

    x: float
    y: float
    name: str
    value: str
    is_outlier: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartLine:
    """``number``: of what it belongs to, the same in all charts; points in the order of x."""

    number: int
    points: Sequence[ChartPoint]


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """``x_ends``: the values at both ends of the axis, and ``x_labels`` what they are called."""

    title: str
    x_ends: tuple[float, float]
    x_labels: tuple[str, str]
    lines: Sequence[ChartLine]


def chart_html(chart: Chart) -> str:
    """A chart with its title, as a figure."""
    points = [point for line in chart.lines for point in line.points]
    outliers = sum(point.is_outlier for point in points)
    title = html.escape(chart.title)
    told = f"{title}: {len(points)} recordings, {outliers} of them flagged"
    low, high = _padded(min(p.y for p in points), max(p.y for p in points))
    place = _Place(x_ends=chart.x_ends, y_ends=(low, high))
    parts = [_axes(chart, place)]
    has_names = len(points) <= _NAMED_POINTS_MAX
    for line in chart.lines:
        parts += _line(line, place, has_names=has_names)
    # Above all lines.
    parts += [_diamond(p, place) for p in points if p.is_outlier]
    return (
        f"<figure><figcaption>{title}</figcaption>"
        f'<svg viewBox="0 0 {_WIDTH:.0f} {_HEIGHT:.0f}" role="img" aria-label="{told}">'
        f"{''.join(parts)}</svg></figure>"
    )


def key_html(label: str, number: int) -> str:
    """An entry of the legend: a line's look with its label."""
    color, dash = _look(number)
    return (
        '<span class="key"><svg width="28" height="12" aria-hidden="true">'
        f'<path d="M1 6H27" stroke="{color}" stroke-width="2" stroke-dasharray="{dash}"/>'
        f'<circle cx="14" cy="6" r="3" fill="{color}"/></svg>'
        f"<bdi>{html.escape(label)}</bdi></span>"
    )


def outlier_key_html(label: str) -> str:
    """The entry of the legend for outliers."""
    return (
        '<span class="key"><svg width="16" height="14" aria-hidden="true">'
        f'<path class="outlier" d="{_diamond_path(8.0, 7.0)}" fill="{OUTLIER_COLOR}"/></svg>'
        f"{html.escape(label)}</span>"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Place:
    """Where values lie in the picture."""

    x_ends: tuple[float, float]
    y_ends: tuple[float, float]

    def x(self, value: float) -> float:
        low, high = self.x_ends
        part = 0.5 if high <= low else (value - low) / (high - low)
        return _LEFT + part * (_WIDTH - _LEFT - _RIGHT)

    def y(self, value: float) -> float:
        low, high = self.y_ends
        return _HEIGHT - _BOTTOM - (value - low) / (high - low) * (_HEIGHT - _TOP - _BOTTOM)


def _padded(low: float, high: float) -> tuple[float, float]:
    margin = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    return low - margin, high + margin


def _axes(chart: Chart, place: _Place) -> str:
    right, bottom = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM
    parts = []
    for value, text in _ticks(*place.y_ends):
        y = place.y(value)
        parts.append(
            f'<path class="grid" d="M{_LEFT:.0f} {y:.1f}H{right:.0f}"/>'
            f'<text x="{_LEFT - 5:.0f}" y="{y + 3.5:.1f}" text-anchor="end">{text}</text>'
        )
    first, last = (html.escape(label) for label in chart.x_labels)
    parts.append(
        f'<path class="axis" d="M{_LEFT:.0f} {bottom:.0f}H{right:.0f}"/>'
        f'<text x="{_LEFT:.0f}" y="{_HEIGHT - 5:.0f}">{first}</text>'
        f'<text x="{right:.0f}" y="{_HEIGHT - 5:.0f}" text-anchor="end">{last}</text>'
    )
    return "".join(parts)


def _ticks(low: float, high: float) -> list[tuple[float, str]]:
    """Round values between two, at equal steps of 1, 2 or 5 times a power of ten."""
    rough = (high - low) / _TICKS_MAX
    power = 10.0 ** floor(log10(rough))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough)
    digits = max(0, -floor(log10(step) + 1e-9))
    first = ceil(low / step - 1e-9)
    values = [place * step for place in range(first, floor(high / step + 1e-9) + 1)]
    # No "-0".
    return [(value, f"{value:.{digits}f}" if value else "0") for value in values]


def _look(number: int) -> tuple[str, str]:
    return _LOOKS[number] if number < LINES_MAX else ("currentColor", "")


def _line(line: ChartLine, place: _Place, *, has_names: bool) -> list[str]:
    color, dash = _look(line.number)
    shown = _thinned(line.points, place)
    path = "".join(
        f"{'L' if n else 'M'}{place.x(point.x):.1f} {place.y(point.y):.1f}"
        for n, point in enumerate(shown)
    )
    faint = ' opacity="0.45"' if line.number >= LINES_MAX else ""
    parts = [
        f'<path d="{path}" fill="none" stroke="{color}" stroke-width="1.3" '
        f'stroke-dasharray="{dash}"{faint}/>'
    ]
    for point in shown:
        if not point.is_outlier:
            name = f"<title>{_told(point)}</title>" if has_names else ""
            parts.append(
                f'<circle cx="{place.x(point.x):.1f}" cy="{place.y(point.y):.1f}" r="{_DOT}" '
                f'fill="{color}"{faint}>{name}</circle>'
            )
    return parts


def _thinned(points: Sequence[ChartPoint], place: _Place) -> list[ChartPoint]:
    """The points, of very many the lowest and the highest of each pixel."""
    if len(points) <= _POINTS_MAX:
        return list(points)
    ends: dict[int, tuple[ChartPoint, ChartPoint]] = {}
    for point in points:
        column = int(place.x(point.x) / (_WIDTH / _BINS))
        lowest, highest = ends.get(column, (point, point))
        ends[column] = (
            point if point.y < lowest.y else lowest,
            point if point.y > highest.y else highest,
        )
    return [point for pair in ends.values() for point in pair]


def _diamond(point: ChartPoint, place: _Place) -> str:
    path = _diamond_path(place.x(point.x), place.y(point.y))
    return (
        f'<path class="outlier" d="{path}" fill="{OUTLIER_COLOR}">'
        f"<title>{_told(point)}</title></path>"
    )


def _diamond_path(x: float, y: float) -> str:
    r = _DIAMOND
    return f"M{x:.1f} {y - r:.1f}L{x + r:.1f} {y:.1f}L{x:.1f} {y + r:.1f}L{x - r:.1f} {y:.1f}Z"


def _told(point: ChartPoint) -> str:
    flagged = ", flagged" if point.is_outlier else ""
    return html.escape(f"{point.name}: {point.value}{flagged}")
