"""Figures of a camera's calibration: matches (Song 2022, Fig. 10), the reprojection curve
(Fig. 11), and the cloud over the image before and after."""

from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from fusion_core.exporting.figures import png_figure
from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ACCEPTED, _REJECTED = "#1b7837", "#b0b0b0"
# More lines than this hide the images.
_LINES_MAX = 120
_POINTS_MAX = 30_000
_IMAGE_WIDTH_PX = 900


def write_matches(
    path: Path,
    heading: str,
    *,
    grey: ByteArray,
    picture: ByteArray,
    image_px: FloatArray,
    intensity_px: FloatArray,
    accepted: BoolArray,
) -> None:
    """The camera's (H, W) image above the (h, w) intensity picture, with lines between the (N, 2)
    pixels of pairs; rejected ones are grey. Of many pairs some are drawn."""
    image, image_scale = _shrunk(grey)
    below, below_scale = _shrunk(picture)
    gap = 12
    width = max(image.shape[1], below.shape[1])
    canvas = np.full((image.shape[0] + gap + below.shape[0], width), 255, dtype=np.uint8)
    canvas[: image.shape[0], : image.shape[1]] = image
    canvas[image.shape[0] + gap :, : below.shape[1]] = below
    a = image_px * image_scale
    b = intensity_px * below_scale + (0.0, image.shape[0] + gap)
    height_in = 3.3 * canvas.shape[0] / width + 0.45
    with png_figure(path, heading, height_in=height_in) as figure:
        axes = figure.subplots()
        axes.imshow(canvas, cmap="gray", vmin=0, vmax=255)
        for chosen, color, line_width in (
            (np.flatnonzero(~accepted), _REJECTED, 0.25),
            (np.flatnonzero(accepted), _ACCEPTED, 0.5),
        ):
            step = max(1, -(-chosen.size // _LINES_MAX))
            some = chosen[::step]
            some = some[np.isfinite(a[some]).all(axis=1)]
            ends = np.stack([a[some], b[some]], axis=1)
            if some.size:
                axes.plot(*ends.transpose(2, 1, 0), color=color, lw=line_width)
                axes.plot(*ends.reshape(-1, 2).T, ".", color=color, ms=1.5)
        axes.set_axis_off()


def write_reprojection_curve(
    path: Path,
    heading: str,
    *,
    pairs: IntArray,
    unfiltered_px: FloatArray,
    filtered_px: FloatArray,
    held_out_px: float | None,
) -> None:
    """Fig. 11: the reprojection error by the number of pairs that the pose is estimated from."""
    with png_figure(path, heading, height_in=2.2) as figure:
        axes = figure.subplots()
        axes.plot(pairs, unfiltered_px, "o-", color="#b35806", ms=2, lw=0.8, label="all pairs")
        axes.plot(pairs, filtered_px, "s-", color=_ACCEPTED, ms=2, lw=0.8, label="after the filter")
        if held_out_px is not None:
            axes.axhline(held_out_px, color="0.3", lw=0.6, ls="--", label="held-out pairs")
        axes.set_xscale("log")
        ticks = [n for n in (10, 20, 50, 100, 200, 500, 1000, 2000, 5000) if n <= pairs.max()]
        axes.set_xticks(ticks, [str(n) for n in ticks])
        axes.set_xticks([], minor=True)
        drawn = np.concatenate([unfiltered_px, filtered_px])
        drawn = drawn[np.isfinite(drawn)]
        top = float(np.quantile(drawn, 0.9)) if drawn.size else 1.0
        axes.set_ylim(0.0, 1.5 * max(top, held_out_px or 0.0))
        axes.set_xlabel("pairs used")
        axes.set_ylabel("reprojection error (18), px")
        axes.grid(visible=True)
        axes.legend()


def write_overlay(
    path: Path, heading: str, *, grey: ByteArray, panels: list[tuple[str, FloatArray, FloatArray]]
) -> None:
    """The cloud over the image, a panel for each (title, (N, 2) pixels, (N,) depths in m); NaN and
    pixels outside of the image are left out."""
    image, scale = _shrunk(grey)
    height_in = len(panels) * (3.2 * image.shape[0] / image.shape[1] + 0.25) + 0.35
    with png_figure(path, heading, height_in=height_in) as figure:
        rows = figure.subplots(len(panels), 1, squeeze=False)
        for axes, (title, pixels, depth_m) in zip(rows[:, 0], panels, strict=True):
            _draw_overlay(axes, image, pixels * scale, depth_m)
            axes.set_title(title)


def _draw_overlay(axes: "Axes", image: ByteArray, pixels: FloatArray, depth_m: FloatArray) -> None:
    axes.imshow(image, cmap="gray", vmin=0, vmax=255)
    height, width = image.shape
    inside = (pixels >= -0.5).all(axis=1) & (pixels < (width - 0.5, height - 0.5)).all(axis=1)
    chosen = np.flatnonzero(inside)
    step = max(1, -(-chosen.size // _POINTS_MAX))
    chosen = chosen[::step]
    # Far points first: near ones hide them.
    chosen = chosen[np.argsort(-depth_m[chosen], kind="stable")]
    if chosen.size:
        low, high = np.percentile(depth_m[chosen], [2.0, 98.0])
        axes.scatter(
            pixels[chosen, 0],
            pixels[chosen, 1],
            c=depth_m[chosen],
            s=0.4,
            cmap="turbo",
            vmin=low,
            vmax=high,
            linewidths=0,
            alpha=0.6,
        )
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_axis_off()


def _shrunk(grey: ByteArray) -> tuple[ByteArray, float]:
    """An image no wider than a figure's pixels, and by how much it was scaled."""
    scale = min(1.0, _IMAGE_WIDTH_PX / grey.shape[1])
    if scale == 1.0:
        return grey, 1.0
    size = (_IMAGE_WIDTH_PX, max(1, round(grey.shape[0] * scale)))
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8), scale
