"""What the figures need of the fused frames: one to show, and the counts of Table 1."""

import numpy as np

from fusion_core.model.classes import is_repaired
from fusion_core.workflows.fuse.align import RecordingAlignment
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.offset_search import OffsetSearch
from fusion_core.workflows.fuse.table_1 import score_range


class FigureCollector:
    """Collects from the fused frames, in bounded memory, one frame to show and the counts of
    Table 1, in which a panorama of several images counts once.

    ``showcase`` is the frame with most repaired samples among those with an overlap of at least
    half and a registration, the earliest of equal ones; where there is none, the same among all.
    """

    def __init__(self, alignment: RecordingAlignment) -> None:
        self._alignment = alignment
        self._rank = (False, -1)
        self._counted: OffsetSearch | None = None
        self.showcase: FusedFrame | None = None
        self.scores = {"low": 0, "middle": 0, "high": 0, "not_positive": 0, "missing": 0}

    def add(self, frame: FusedFrame) -> None:
        """Count a frame, and keep it if it ranks first."""
        # The images of a panorama follow each other and share its search.
        if frame.match.search is not self._counted:
            self._counted = frame.match.search
            self.scores[score_range(self._counted.peaks_without_prior.get("pearson"))] += 1
        peak = frame.match.search.peaks.get(self._alignment.metric)
        is_sound = frame.match.registration is not None and peak is not None and peak.overlap >= 0.5
        rank = (is_sound, _repaired_count(frame))
        if rank > self._rank:
            self._rank, self.showcase = rank, frame


def _repaired_count(frame: FusedFrame) -> int:
    sources = np.concatenate([frame.repair.lidar_source, frame.repair.depth_source])
    return int(is_repaired(sources).sum())
