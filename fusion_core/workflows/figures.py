"""The paper's figures for a fused recording."""

from pathlib import Path

from fusion_core.model.grids import OccupancyGrid
from fusion_core.workflows.align import Alignment
from fusion_core.workflows.frame import FusedFrame


class FigureCollector:
    """Keeps, in bounded memory, what the figures need of the frames that pass by."""

    def __init__(self, alignment: Alignment) -> None:
        self._alignment = alignment

    def add(self, frame: FusedFrame) -> None:
        """Take note of one frame."""


def write_figures(
    folder: Path,
    session: object,
    alignment: Alignment,
    collected: FigureCollector,
    grids: dict[str, OccupancyGrid],
    *,
    fuse_dir: Path,
    truth: Path | None,
) -> None:
    """Draw."""
