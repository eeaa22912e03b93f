"""The estimate of SLAM while it runs, for display."""

from collections.abc import Callable
from dataclasses import dataclass

from fusion_core.model.conventions import FloatArray, IntArray, read_only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlamView:
    """A snapshot of a run.

    ``stage``: its label. ``stamps_ns``: (N,) of the scans placed so far; ``poses_map_scan``: (N, 3)
    x, y, yaw of the LiDAR, as estimated so far. ``particles``: (P, 3) their poses at the
    last scan, (0, 3) without a particle filter; ``weights``: (P,) of them, their sum 1.
    ``effective``: (N,) effective number of particles at each scan, NaN where the filter was not
    updated, (0,) without particles. ``loops_m``: (L, 4) x, y of the two ends of each loop closure.
    """

    stage: str
    stamps_ns: IntArray
    poses_map_scan: FloatArray
    particles: FloatArray
    weights: FloatArray
    effective: FloatArray
    loops_m: FloatArray

    def __post_init__(self) -> None:
        for array in (
            self.stamps_ns,
            self.poses_map_scan,
            self.particles,
            self.weights,
            self.effective,
            self.loops_m,
        ):
            read_only(array)


SlamObserver = Callable[[SlamView], None]
"""Called every few scans, on the thread of the run; what it raises ends the run."""


def no_observer(view: SlamView) -> None:
    """Observes nothing."""
