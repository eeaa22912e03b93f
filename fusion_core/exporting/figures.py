"""What all figures share: style, images, colour bars, legends, and reproducible bytes.

Each is as wide as one column of a printed page, with letters that can be read there.
"""

import textwrap
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import cv2
import numpy as np

from fusion_core.exporting.palette import HOLE
from fusion_core.files.atomic import write_bytes
from fusion_core.model.conventions import (
    NS_PER_MS,
    ByteArray,
    Float32Array,
    FloatArray,
    wrap_angle,
)
from fusion_core.model.errors import ExportError

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.image import AxesImage

COLUMN_IN = 3.5
"""Width of every figure: one column of a journal's page (IEEE: 3.5 in)."""
# What journals ask for in print.
_DPI = 300
# Letters of a heading that fit the width of a figure.
_HEADING_LETTERS = 68
_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 6.5,
    "axes.titlesize": 6.5,
    "axes.titlepad": 3.0,
    # To search for a free place above each panel would add a sixth to the time of a run's figures.
    "axes.titley": 1.0,
    "axes.labelsize": 6.0,
    "axes.labelpad": 1.5,
    "xtick.labelsize": 5.5,
    "ytick.labelsize": 5.5,
    "xtick.major.size": 2.0,
    "ytick.major.size": 2.0,
    "xtick.major.pad": 1.5,
    "ytick.major.pad": 1.5,
    "xtick.major.width": 0.4,
    "ytick.major.width": 0.4,
    "figure.titlesize": 7.0,
    "figure.constrained_layout.h_pad": 0.02,
    "figure.constrained_layout.w_pad": 0.02,
    "legend.fontsize": 6.0,
    "legend.framealpha": 0.9,
    "legend.handlelength": 1.2,
    "legend.handletextpad": 0.5,
    "legend.columnspacing": 1.2,
    "legend.labelspacing": 0.3,
    "legend.borderpad": 0.3,
    "axes.linewidth": 0.4,
    "axes.grid": False,
    "grid.linewidth": 0.3,
    "grid.color": "0.85",
    "hatch.linewidth": 0.4,
    "lines.markeredgewidth": 0.2,
    "patch.linewidth": 0.4,
    "image.interpolation": "nearest",
    # A dollar sign in a name does not begin a formula.
    "text.parse_math": False,
}
NO_VALUE_COLOR = "#d9d9d9"
# Few shades keep the files small, and a shade can be found in the colour bar.
_DEPTH_SHADES = 64


@contextmanager
def png_figure(path: Path, heading: str, *, height_in: float) -> Iterator["Figure"]:
    """A figure of width ``COLUMN_IN`` that is written as PNG when the block ends without error.

    Lines of ``heading`` that are too long are broken. The bytes do not depend on the clock or on
    the user's matplotlib settings. Raises ExportError where the file cannot be written.
    """
    import matplotlib.style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.style.context(["default", _STYLE]):
        width_px, height_px = round(_DPI * COLUMN_IN), round(_DPI * height_in)
        size_in = (width_px / _DPI, height_px / _DPI)
        figure = Figure(figsize=size_in, dpi=_DPI, layout="constrained")
        lines = (textwrap.fill(line, _HEADING_LETTERS) for line in heading.splitlines())
        figure.suptitle("\n".join(lines))
        yield figure
        _freeze_layout(figure)
        # Figure.savefig would go through all that is drawn twice.
        canvas: Any = FigureCanvasAgg(figure)
        canvas.draw()
    rgba = np.asarray(canvas.buffer_rgba())
    # OpenCV's file is smaller than matplotlib's, and holds no date or version. The last two levels
    # of compression take five times as long for 3 % of the size.
    done, png = cv2.imencode(".png", rgba[:, :, 2::-1], [cv2.IMWRITE_PNG_COMPRESSION, 7])
    if not done:
        raise ExportError("cannot be encoded as PNG.", file=path)
    write_bytes(path, png.tobytes())


def leave_margin(figure: "Figure", part: float) -> None:
    """Keep this part of a figure's width free on either side."""
    engine: Any = figure.get_layout_engine()
    engine.set(rect=(part, 0.0, 1.0 - 2.0 * part, 1.0))


def _freeze_layout(figure: "Figure") -> None:
    """Lay out parts and panels once and round their positions: the layout's solver orders its terms
    by memory address, so that its last digits differ between runs."""
    engine = figure.get_layout_engine()
    assert engine is not None, "png_figure makes figures with one"
    if figure.get_axes():
        engine.execute(figure)
    figure.set_layout_engine("none")
    for part in figure.subfigs:
        part.bbox_relative.set_points(part.bbox_relative.get_points().round(5))
    for axes in figure.get_axes():
        x, y, width, height = (round(value, 5) for value in axes.get_position(True).bounds)
        axes.set_position((x, y, width, height))


def show_color(axes: "Axes", rgb: ByteArray) -> None:
    """A colour image with its pixel numbers."""
    axes.imshow(rgb)
    _label_pixels(axes)


def depth_shades() -> "Colormap":
    """Grey for depths, near dark; holes in their colour."""
    import matplotlib as mpl

    return mpl.colormaps["gray"].resampled(_DEPTH_SHADES).with_extremes(bad=HOLE)


def show_depth(axes: "Axes", depth_m: Float32Array, *, far_m: float) -> None:
    """A depth image with a colour bar."""
    image = axes.imshow(depth_m, cmap=depth_shades(), vmin=0.0, vmax=far_m)
    _label_pixels(axes)
    add_color_bar(axes, image, "depth (m)", beyond="max")


def _label_pixels(axes: "Axes") -> None:
    axes.set_xlabel("column (px)")
    axes.set_ylabel("row (px)")


def add_color_bar(
    axes: "Axes",
    image: "AxesImage",
    label: str,
    *,
    beyond: Literal["neither", "max"] = "neither",
    left: float = 1.02,
) -> None:
    """A colour bar as high as ``axes``, its left edge at ``left`` in units of their width."""
    figure = axes.get_figure()
    assert figure is not None, "axes are made by a figure"
    place = axes.inset_axes((left, 0.0, 0.05, 1.0))
    figure.colorbar(image, cax=place, label=label, extend=beyond, extendfrac=0.03)


def add_legend_below(
    figure: "Figure | SubFigure", panels: "Iterable[Axes]", *, columns: int, caption: str = ""
) -> None:
    """One legend for all panels below them, each entry once, with ``caption`` above it."""
    entries: dict[str, Artist] = {}
    for axes in panels:
        handles, labels = axes.get_legend_handles_labels()
        for handle, label in zip(handles, labels, strict=True):
            entries.setdefault(label, handle)
    figure.legend(
        list(entries.values()),
        list(entries),
        loc="outside lower center",
        ncols=columns,
        frameon=False,
        title=caption or None,
        title_fontsize=6.0,
        alignment="left",
    )


def start_at_zero(axes: "Axes", *, headroom: float = 0.08) -> None:
    """Limits of a range axis: from 0 to a little more than what is drawn."""
    top = float(axes.dataLim.y1)
    axes.set_ylim(0.0, (1.0 + headroom) * top if np.isfinite(top) and top > 0.0 else 1.0)


def show_holes(axes: "Axes", azimuth_deg: FloatArray, range_m: FloatArray) -> None:
    """A tick at range 0 for each beam without a value."""
    empty = ~np.isfinite(range_m)
    if empty.any():
        axes.plot(
            azimuth_deg[empty],
            np.zeros(empty.sum()),
            "|",
            color=HOLE,
            ms=4,
            mew=0.5,
            clip_on=False,
            label="hole: beam without a value",
        )


def far_limit_m(depth_m: Float32Array) -> float:
    """Where the depth scale ends: beyond nearly all depths, 1 m for an image of holes."""
    valid = depth_m[np.isfinite(depth_m)]
    return float(np.percentile(valid, 99.5)) if valid.size else 1.0


def continuous_deg(azimuth_rad: FloatArray, middle_rad: float) -> FloatArray:
    """Azimuths in degrees, within 180 of ``middle_rad``, so that they do not jump there."""
    degrees: FloatArray = np.rad2deg(middle_rad + wrap_angle(azimuth_rad - middle_rad))
    return degrees


def middle_of_view_rad(azimuth_rad: FloatArray) -> float:
    """Mean direction of azimuths, 0 for none."""
    return float(np.angle(np.exp(1j * azimuth_rad).sum()))


def label_azimuth(axes: "Axes") -> None:
    """Label an axis of azimuths; they increase to the left, as in the image."""
    axes.set_xlabel("azimuth in the LiDAR frame (°)")
    if not axes.xaxis_inverted():
        axes.invert_xaxis()


def describe_delay(delay_ms: float, reference: str) -> str:
    """How long after ``reference`` (negative: before), as text."""
    if delay_ms == 0.0:
        return f"at the stamp of {reference}"
    return f"{abs(delay_ms):.1f} ms {'after' if delay_ms > 0.0 else 'before'} {reference}"


def format_stamp(stamp_ns: int) -> str:
    """A stamp in seconds, rounded to the millisecond."""
    milliseconds = round(stamp_ns / NS_PER_MS)
    return f"{milliseconds // 1000}.{milliseconds % 1000:03d} s"
