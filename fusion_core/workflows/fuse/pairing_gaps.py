"""How far in time each depth image of a recording lies from its scan."""

from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from fusion_core.alignment.time import TimeSettings
from fusion_core.model.conventions import NS_PER_MS, BoolArray, FloatArray, IntArray, read_only
from fusion_core.model.sensors import LaserScan
from fusion_core.model.stamps import NO_STAMP, nearest_stamps
from fusion_core.workflows.fuse.pairing import PairedImage


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairingGaps:
    """The n depth images of a recording, in the order in which they were paired.

    ``time_ns``: (n,) log times. ``gap_ms``: (n,) image stamp, less the applied clock offset, less
    the stamp of the nearest scan, or by rates of the scan that is counted; NaN where there is no
    scan. ``is_paired``: (n,) whether the image is paired with it: a nearest one may be too far
    away. ``scan_period_ms``: median time between scans, NaN for fewer than two.
    """

    time_ns: IntArray
    gap_ms: FloatArray
    is_paired: BoolArray
    scan_period_ms: float

    def __post_init__(self) -> None:
        if not self.time_ns.shape == self.gap_ms.shape == self.is_paired.shape:
            raise ValueError("time_ns, gap_ms and is_paired must have one length")
        for array_ in (self.time_ns, self.gap_ms, self.is_paired):
            read_only(array_)


class PairingStamps:
    """The stamps of all scans and depth images, collected in a pass over a recording.

    One pass serves every clock offset, since the gaps follow from the stamps only.
    """

    def __init__(self) -> None:
        self._scan_ns = array("q")
        self._image_ns = array("q")
        self._paired_ns = array("q")
        self._time_ns = array("q")
        self.is_complete = False

    def observe(
        self, entries: Iterable[LaserScan | PairedImage]
    ) -> Iterator[LaserScan | PairedImage]:
        """Pass the entries on and collect their stamps; ``is_complete`` after the last one."""
        for entry in entries:
            if isinstance(entry, LaserScan):
                self._scan_ns.append(entry.stamp_ns)
            else:
                image = entry.image
                logged_ns = image.stamp_ns if image.received_ns is None else image.received_ns
                self._image_ns.append(image.stamp_ns)
                window = entry.window
                self._paired_ns.append(NO_STAMP if window is None else window.scan.stamp_ns)
                self._time_ns.append(logged_ns)
            yield entry
        self.is_complete = True

    def gaps(self, clock_offset_ms: float, settings: TimeSettings) -> PairingGaps:
        """The gaps with this clock offset taken out of the images' stamps. By rates, ``settings``
        are those of the pass."""
        scan_ns = np.sort(np.array(self._scan_ns, dtype=np.int64))
        image_ns = np.array(self._image_ns, dtype=np.int64) - round(clock_offset_ms * NS_PER_MS)
        gap_ms = np.full(image_ns.shape, np.nan)
        paired = np.zeros(image_ns.shape, dtype=np.bool_)
        if settings.pair_by == "rates":
            paired_ns = np.array(self._paired_ns, dtype=np.int64)
            paired = paired_ns != NO_STAMP
            gap_ms[paired] = (image_ns - paired_ns)[paired] / NS_PER_MS
        elif scan_ns.size:
            gap_ns = image_ns - scan_ns[nearest_stamps(scan_ns, image_ns)]
            paired = np.abs(gap_ns) <= round(settings.max_gap_ms * NS_PER_MS)
            gap_ms = gap_ns / NS_PER_MS
        period_ms = float(np.median(np.diff(scan_ns))) / NS_PER_MS if scan_ns.size > 1 else np.nan
        return PairingGaps(
            time_ns=np.array(self._time_ns, dtype=np.int64),
            gap_ms=gap_ms,
            is_paired=paired,
            scan_period_ms=period_ms,
        )
