"""What the figures need of the fused frames: one to show, and the counts of Table 1."""

from collections.abc import Callable

from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_tasks import FrameTask
from fusion_core.workflows.fuse.fused_results import TaskResults


class FigureCollector:
    """Collects from the results, in bounded memory, one frame to show and the counts of Table 1, in
    which a panorama of several images counts once.

    The frame to show is the one of the highest rank, the earliest of equal ones.
    """

    def __init__(self) -> None:
        self._rank = (False, -1)
        self._best: tuple[FrameTask, int] | None = None
        self.scores = {"low": 0, "middle": 0, "high": 0, "not_positive": 0, "missing": 0}

    def add(self, entry: TaskResults) -> None:
        """Count the images of a task, and keep it if one of them ranks first."""
        for result in entry.results:
            if result.score_range is not None:
                self.scores[result.score_range] += 1
            if result.rank > self._rank:
                self._rank, self._best = result.rank, (entry.task, result.camera)

    def showcase(self, fuse: Callable[[FrameTask], list[FusedFrame] | None]) -> FusedFrame | None:
        """The frame to show, fused once more: its fields are too large to be kept for each frame
        that ranks first for a while. None where no frame was fused."""
        if self._best is None:
            return None
        task, camera = self._best
        frames = fuse(task) or ()
        return next(frame for frame in frames if frame.match.pair.camera_index == camera)
