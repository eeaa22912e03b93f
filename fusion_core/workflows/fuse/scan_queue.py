"""Each input scan once, with the repairs of all images paired with it."""

from collections.abc import Iterator

import numpy as np

from fusion_core.denoising.overruling import is_rejected
from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import FloatArray
from fusion_core.model.labels import CaptureLabels
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.frame_result import FrameResult
from fusion_core.workflows.fuse.pairing import SCANS_KEPT


class _WaitingScan:
    def __init__(self, scan: LaserScan, labels: CaptureLabels | None) -> None:
        self.scan = scan
        self.ranges_m = scan.ranges_m.copy()
        self.codes = np.where(
            np.isfinite(scan.ranges_m), float(NoiseClass.GOOD), float(NoiseClass.HOLE)
        )
        if labels is not None:
            code = labels.as_image()[0]
            self.codes = np.where(np.isin(code, list(NoiseClass)), code, self.codes)
            self.ranges_m[is_rejected(code)] = np.nan
        self.gap_ns: FloatArray = np.full(scan.ranges_m.size, np.inf)


class RepairedScanQueue:
    """Scans wait until no image can be paired with them any more, so memory stays bounded.

    Where two images repair the same beam, the one nearer in time decides.
    """

    def __init__(self) -> None:
        # By identity: some drivers give two scans one stamp.
        self._pending: dict[int, _WaitingScan] = {}

    def push(self, scan: LaserScan, labels: CaptureLabels | None = None) -> None:
        """Add a scan of the recording, whose ``labels`` hold outside of all images too."""
        self._pending[id(scan)] = _WaitingScan(scan, labels)

    def apply_repairs(self, scan: LaserScan, result: FrameResult) -> None:
        """Apply the repairs of one image to its scan, which must still wait."""
        pending = self._pending[id(scan)]
        nearer = abs(result.gap_ns) < pending.gap_ns[result.beam]
        beam = result.beam[nearer]
        pending.gap_ns[beam] = abs(result.gap_ns)
        pending.ranges_m[beam] = result.lidar_repaired_m[nearer]
        pending.codes[beam] = result.lidar_class[nearer]

    def pop_settled(self) -> Iterator[tuple[LaserScan, LaserScan]]:
        """Raw and repaired scans that no image can be paired with any more, in order of arrival."""
        while len(self._pending) > SCANS_KEPT:
            yield self._pop_oldest()

    def flush(self) -> Iterator[tuple[LaserScan, LaserScan]]:
        """All that still wait."""
        while self._pending:
            yield self._pop_oldest()

    def _pop_oldest(self) -> tuple[LaserScan, LaserScan]:
        pending = self._pending.pop(next(iter(self._pending)))
        return pending.scan, pending.scan.with_ranges(pending.ranges_m, pending.codes)


def ranges_without_burrs_m(raw: LaserScan, repaired: LaserScan) -> FloatArray:
    """(N,) repaired ranges of a scan from the queue, NaN where a burr could not be repaired: it is
    not an obstacle, and the space before it need not be free."""
    unrepaired = (repaired.intensities == NoiseClass.BURR) & (repaired.ranges_m == raw.ranges_m)
    return np.where(unrepaired, np.nan, repaired.ranges_m)
