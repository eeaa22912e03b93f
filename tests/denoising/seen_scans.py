"""Scans before and after, as tests have them."""

import numpy as np
import numpy.typing as npt

from fusion_core.alignment.moved_scan import MovedScan


def seen(ranges_m: npt.ArrayLike, looked: npt.ArrayLike | None = None) -> MovedScan:
    """Another scan, as seen from the frame's place. ``looked``: by default every beam did."""
    ranges_m = np.array(ranges_m, dtype=np.float64)
    return MovedScan(
        ranges_m=ranges_m,
        looked=np.full(ranges_m.size, True) if looked is None else np.array(looked),
    )
