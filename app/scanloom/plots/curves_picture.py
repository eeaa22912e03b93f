"""The LiDAR's curve and the depth row that are compared at one offset, sample by sample."""

import cv2
import numpy as np

from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray
from scanloom.plots import sheet as paper
from scanloom.plots.lettering import write
from scanloom.plots.palette import Color, color_of
from scanloom.plots.sheet import LINE_PX, MARGIN_PX, Box, LegendEntry

_LEFT_PX, _BELOW_PX = 54, 40
_MARGIN_SHARE = 0.06


def curves_picture(
    lidar_m: FloatArray, depth_m: FloatArray, *, width_px: int, height_px: int
) -> ByteArray:
    """(height_px, width_px, 3) uint8: two curves of (W,) ranges in metres over the samples of the
    row; a NaN is a gap. Raises ValueError where the picture is too small."""
    rgb = paper.blank_sheet(width_px, height_px)
    both = np.concatenate([lidar_m, depth_m])
    seen = both[np.isfinite(both)]
    top = MARGIN_PX + 4
    legend = paper.legend_lines(
        [
            LegendEntry(paper.swatch(color_of("lidar")), "LiDAR curve"),
            LegendEntry(paper.swatch(color_of("depth")), "depth row"),
        ],
        width_px - 2 * MARGIN_PX,
    )
    bottom = height_px - _BELOW_PX - len(legend) * LINE_PX
    box = paper.room(_LEFT_PX, top, width_px - MARGIN_PX, bottom)
    box.frame(rgb)
    low, high = (0.0, 1.0)
    if seen.size:
        low, high = paper.wide_limits(float(seen.min()), float(seen.max()))
        margin = _MARGIN_SHARE * (high - low)
        low, high = low - margin, high + margin
    _axes(rgb, box, lidar_m.size, low, high)
    for values_m, name in ((depth_m, "depth"), (lidar_m, "lidar")):
        color = color_of("depth") if name == "depth" else color_of("lidar")
        _draw(box.view(rgb), values_m, low, high, color)
    paper.draw_legend(rgb, legend, MARGIN_PX, bottom + _BELOW_PX - 4)
    return rgb


def _axes(rgb: ByteArray, box: Box, count: int, low: float, high: float) -> None:
    for sample in paper.whole_ticks_between(0, max(count - 1, 1), max(2, box.width // 60)):
        x = box.left + (sample + 0.5) * box.width / max(count, 1)
        paper.tick_below(rgb, box, x, paper.number(sample))
    for metres in paper.ticks_between(low, high, max(2, box.height // 34)):
        y = box.top + (high - metres) / (high - low) * box.height
        paper.tick_left(rgb, box, y, paper.number(metres))
    middle = box.left + 0.5 * box.width
    write(rgb, "sample of the row, from the left", middle, box.bottom + 27, align="middle")
    write(rgb, "range (m)", 11, box.top + 0.5 * box.height, align="middle", turned=True)


def _draw(part: ByteArray, values_m: FloatArray, low: float, high: float, color: Color) -> None:
    """A line through neighbouring values, and a dot at each: one alone must be seen."""
    height, width = part.shape[:2]
    valid: BoolArray = np.isfinite(values_m)
    x = (np.arange(values_m.size) + 0.5) * width / max(values_m.size, 1)
    y = (high - np.where(valid, values_m, low)) / (high - low) * height
    points = np.rint(np.stack([x, y], axis=1)).astype(np.int32)
    ends = np.flatnonzero(~valid)
    for run in np.split(np.arange(values_m.size), ends):
        inside = run[valid[run]]
        if inside.size:
            cv2.polylines(part, [points[inside]], False, color, 2, cv2.LINE_AA)
    for point in points[valid]:
        cv2.circle(part, (int(point[0]), int(point[1])), 2, color, -1, cv2.LINE_AA)
