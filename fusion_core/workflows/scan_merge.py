"""Each input scan once, with what the images paired with it have repaired."""

from collections.abc import Iterator

import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import NS_PER_S, FloatArray
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.frame import FusedFrame

# Images arrive in the order of their log; a scan this much older than the last one waits for none.
_PATIENCE_NS = 2 * NS_PER_S


class _Pending:
    def __init__(self, scan: LaserScan) -> None:
        self.scan = scan
        self.ranges_m = scan.ranges_m.copy()
        self.codes = np.where(
            np.isfinite(scan.ranges_m), float(NoiseClass.GOOD), float(NoiseClass.HOLE)
        )
        self.gap_ns: FloatArray = np.full(scan.ranges_m.size, np.inf)


class ScanMerge:
    """Scans wait until no image can be paired with them any more, so memory stays bounded.

    Where two images judge the same beam, the one nearer in time decides.
    """

    def __init__(self) -> None:
        self._pending: dict[int, _Pending] = {}

    def arrive(self, scan: LaserScan) -> None:
        """A scan as it comes from the recording."""
        self._pending.setdefault(scan.stamp_ns, _Pending(scan))

    def add(self, frame: FusedFrame) -> None:
        """The repairs of one image."""
        pending = self._pending.get(frame.scan.stamp_ns)
        if pending is None:
            return
        beam = frame.pairs.beam
        nearer = abs(frame.gap_ns) < pending.gap_ns[beam]
        beam = beam[nearer]
        pending.gap_ns[beam] = abs(frame.gap_ns)
        pending.ranges_m[beam] = frame.repair.lidar_range_m[nearer]
        pending.codes[beam] = frame.classes.lidar_class[nearer]

    def finished(self, stamp_ns: int) -> Iterator[tuple[LaserScan, LaserScan]]:
        """Raw and repaired scans that are old enough at ``stamp_ns``, in order of arrival."""
        for key in [key for key in self._pending if key < stamp_ns - _PATIENCE_NS]:
            yield self._take(key)

    def rest(self) -> Iterator[tuple[LaserScan, LaserScan]]:
        """All that still wait."""
        for key in list(self._pending):
            yield self._take(key)

    def _take(self, key: int) -> tuple[LaserScan, LaserScan]:
        pending = self._pending.pop(key)
        return pending.scan, pending.scan.with_ranges(pending.ranges_m, pending.codes)
