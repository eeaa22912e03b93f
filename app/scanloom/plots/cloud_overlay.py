"""A cloud's points over a camera's image, coloured by depth; the image is grey under them."""

from typing import TYPE_CHECKING

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray
from scanloom.plots.axes import image_axes
from scanloom.plots.canvas import Box, blank_canvas
from scanloom.plots.color_scale import ColorScale
from scanloom.plots.dock_layout import DockLayout, draw_close_axes
from scanloom.plots.palette import color_map
from scanloom.plots.text import draw_text
from scanloom.plots.theme import LIGHT, Theme
from scanloom.plots.ticks import distinct_limits

if TYPE_CHECKING:
    # It takes long to import, and most recordings are of another kind.
    from fusion_core.workflows.calibrate.recorded_camera import CloudInImage

_TITLE_ROOM_PX = 22
_HEIGHT_PX = 2000
# A few far points must not take the colours.
_PERCENTS = (2.0, 98.0)


def cloud_overlay_picture(
    grey: ByteArray,
    cloud: "CloudInImage",
    *,
    title: str,
    width_px: int,
    opacity: float,
    theme: Theme = LIGHT,
) -> ByteArray:
    """Draw a cloud over an (H, W) grey image and return the picture, (h, w, 3) uint8."""
    layout = DockLayout.of([], width_px, _HEIGHT_PX)
    zoom = layout.space.width / grey.shape[1]
    height = max(1, int(zoom * grey.shape[0]))
    box = Box(layout.space.left, layout.space.top + _TITLE_ROOM_PX, layout.space.width, height)
    drawn = blank_canvas(width_px, layout.height_px(box), theme)
    axes = image_axes(drawn, box, (grey.shape[0], grey.shape[1]), theme=theme)
    size = box.width, box.height
    axes.inside[:] = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)[..., np.newaxis]
    limits = None
    if cloud.depth_m.size:
        low, high = map(float, np.percentile(cloud.depth_m, _PERCENTS))
        limits = distinct_limits(low, high)
        step = np.clip((cloud.depth_m - limits[0]) / (limits[1] - limits[0]), 0.0, 1.0)
        colors = color_map("viridis")[(255.0 * step).astype(np.uint8)]
        columns, rows = np.floor((cloud.pixels + 0.5) * zoom).astype(np.int64).T
        covered = axes.inside.copy()
        covered[np.clip(rows, 0, height - 1), np.clip(columns, 0, box.width - 1)] = colors
        axes.inside[:] = cv2.addWeighted(covered, opacity, axes.inside, 1.0 - opacity, 0.0)
    draw_close_axes(axes, "column", "row")
    draw_text(drawn, title, (layout.space.left, layout.space.top + 10), color=theme.ink)
    scale = ColorScale(colors=color_map("viridis"), limits=limits, theme=theme)
    ends = ("", "") if limits is None else (f"{limits[0]:.1f}", f"{limits[1]:.1f} m")
    layout.draw_scale(drawn, scale, "depth", ends, none="no point")
    return drawn
