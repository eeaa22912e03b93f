"""Which parts of the image the corners cover, and how far each is from where the camera puts it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fusion_core.exporting.figures import add_color_bar, png_figure
from fusion_core.exporting.palette import BURR
from fusion_core.model.conventions import FloatArray

# The residuals are a fraction of a pixel: as long arrows they would hide the corners.
_ARROW_FRACTION = 0.03


@dataclass(frozen=True, slots=True, kw_only=True)
class Coverage:
    """``corners_px``, ``residuals_px``: (N, 2) each, over all images that were used.
    ``outliers_px``: (M, 2) corners of images that were left out. ``cells``: across and down."""

    shape: tuple[int, int]
    corners_px: FloatArray
    residuals_px: FloatArray
    outliers_px: FloatArray
    cells: tuple[int, int]


def write_coverage(path: Path, heading: str, coverage: Coverage) -> None:
    """The corners over cells of the image, coloured by their number, with residuals as arrows."""
    height, width = coverage.shape
    across, down = coverage.cells
    counts, _, _ = np.histogram2d(
        coverage.corners_px[:, 1],
        coverage.corners_px[:, 0],
        bins=(down, across),
        range=((0.0, height), (0.0, width)),
    )
    lengths = np.linalg.norm(coverage.residuals_px, axis=1)
    longest_px = float(lengths.max())
    scale = _ARROW_FRACTION * width / max(longest_px, 1e-9)
    with png_figure(path, heading, height_in=2.7 * height / width + 0.7) as figure:
        axes = figure.subplots()
        image = axes.imshow(
            np.where(counts > 0, counts, np.nan),
            extent=(-0.5, width - 0.5, height - 0.5, -0.5),
            cmap="Blues",
            vmin=0.0,
            aspect="equal",
        )
        add_color_bar(axes, image, "corners in a cell")
        axes.quiver(
            *coverage.corners_px.T,
            *(scale * coverage.residuals_px).T,
            angles="xy",
            scale_units="xy",
            scale=1.0,
            width=0.002,
            color="black",
        )
        if coverage.outliers_px.size:
            axes.plot(*coverage.outliers_px.T, "x", color=BURR, ms=2.0, mew=0.4)
        axes.set_xlim(-0.5, width - 0.5)
        axes.set_ylim(height - 0.5, -0.5)
        axes.set_xlabel(f"column (px); the longest arrow is an error of {longest_px:.2f} px")
        axes.set_ylabel("row (px)")


def joined(arrays: Sequence[FloatArray]) -> FloatArray:
    """(N, 2) of all arrays, none where there is none."""
    return np.concatenate([np.empty((0, 2)), *arrays])
