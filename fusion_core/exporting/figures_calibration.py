"""Pictures of a calibration: the cloud over the image, before and after."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fusion_core.exporting.figures import COLUMN_IN, png_figure
from fusion_core.model.conventions import ByteArray, FloatArray, read_only

# Room beside the images for titles and the colour bar.
_TITLES_IN = 0.55
_POINT_SIZE = 0.5
_COLOURS = "turbo"


@dataclass(frozen=True, slots=True, kw_only=True)
class CloudOverImage:
    """Points of a cloud where they appear in an image under one pose. ``pixels``: (N, 2) u, v.
    ``range_m``: (N,). ``title``: what pose it is."""

    pixels: FloatArray
    range_m: FloatArray
    title: str

    def __post_init__(self) -> None:
        if self.pixels.shape != (self.range_m.size, 2):
            raise ValueError(f"pixels must be (N, 2), got {self.pixels.shape}")
        read_only(self.pixels)
        read_only(self.range_m)


def write_cloud_over_image(
    path: Path, heading: str, grey: ByteArray, clouds: Sequence[CloudOverImage]
) -> None:
    """One panel for each pose, below each other: the (H, W) image, and the points coloured by
    range. Raises ExportError where the file cannot be written."""
    from matplotlib.colors import LogNorm

    height, width = grey.shape
    shown = np.concatenate([cloud.range_m for cloud in clouds])
    nearest, farthest = np.percentile(shown, [1.0, 99.0]) if shown.size else (1.0, 10.0)
    # Twice as far is as much of another colour near and far.
    norm = LogNorm(max(nearest, 1e-3), max(farthest, 1.01 * nearest, 1e-2))
    height_in = len(clouds) * (COLUMN_IN * height / width + 0.2) + _TITLES_IN
    with png_figure(path, heading, height_in=height_in) as figure:
        panels = np.atleast_1d(figure.subplots(len(clouds), 1))
        for axes, cloud in zip(panels, clouds, strict=True):
            axes.set_title(cloud.title)
            axes.imshow(grey, cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
            drawn = axes.scatter(
                *cloud.pixels.T,
                c=cloud.range_m,
                s=_POINT_SIZE,
                cmap=_COLOURS,
                norm=norm,
                linewidths=0.0,
            )
            axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
            axes.set_axis_off()
        low, high = norm.vmin or 1.0, norm.vmax or 10.0
        ticks = np.unique(np.geomspace(low, high, 6)[1:-1].round(0))
        bar = figure.colorbar(drawn, ax=list(panels), orientation="horizontal", aspect=60, pad=0.01)
        bar.set_ticks(ticks[(ticks >= low) & (ticks <= high)].tolist(), minor=False)
        bar.minorticks_off()
        bar.ax.xaxis.set_major_formatter("{x:g}")
        bar.set_label("range (m)")
