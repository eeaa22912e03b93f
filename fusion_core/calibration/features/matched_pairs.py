"""Points of a LiDAR paired with pixels of a camera, with those that were rejected and why."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, read_only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MatchedPairs:
    """N pairs: ``image_px`` (N, 2) pixels of the camera's image, ``intensity_px`` (N, 2) of the
    intensity image, ``points_m`` (N, 3) in the LiDAR's frame, NaN where there is none.

    ``reasons``: why a pair was rejected, empty for an accepted one.
    """

    image_px: FloatArray
    intensity_px: FloatArray
    points_m: FloatArray
    reasons: tuple[str, ...]

    def __post_init__(self) -> None:
        count = len(self.reasons)
        for name, array, width in (
            ("image_px", self.image_px, 2),
            ("intensity_px", self.intensity_px, 2),
            ("points_m", self.points_m, 3),
        ):
            if array.shape != (count, width):
                raise ValueError(f"{name} must be ({count}, {width}), got {array.shape}")
            read_only(array)
        kept = self.accepted
        if not (np.isfinite(self.image_px[kept]).all() and np.isfinite(self.points_m[kept]).all()):
            raise ValueError("accepted pairs must have a pixel and a point")

    @property
    def accepted(self) -> BoolArray:
        """(N,) pairs that are used."""
        return np.array([reason == "" for reason in self.reasons], dtype=np.bool_)

    @property
    def distinct(self) -> int:
        """Accepted pairs at different pixels: a feature with two orientations counts once."""
        kept = np.round(self.image_px[self.accepted])
        return len(np.unique(kept, axis=0))

    def rejected(self, pairs: Sequence[int] | np.ndarray, reason: str) -> "MatchedPairs":
        """The same with these pairs (indices) rejected as well."""
        reasons = list(self.reasons)
        for index in pairs:
            reasons[int(index)] = reason
        return replace(self, reasons=tuple(reasons))
