"""The weight of each source in each fused step."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FusionWeights:
    """Weights of S sources in N - 1 fused steps.

    ``stamps_ns``: (N,) of the trajectory. ``translation``, ``rotation``: (N - 1, S), each row sums
    to 1, or is all 0 where no source measured the step. ``rejected``: (N - 1, S) where a source
    measured but was rejected as inconsistent. ``residual_m``, ``residual_rad``: (N - 1, S) distance
    of a source's step from the fused one, NaN where it measured none. ``gain``: (N - 1, 3) K of Li
    2022 (6) for x, y and yaw, of ``published`` alone.
    """

    sources: tuple[str, ...]
    stamps_ns: IntArray
    translation: FloatArray
    rotation: FloatArray
    rejected: BoolArray
    residual_m: FloatArray
    residual_rad: FloatArray
    gain: FloatArray | None = None

    def __post_init__(self) -> None:
        shape = (self.stamps_ns.size - 1, len(self.sources))
        arrays = {
            "translation": self.translation,
            "rotation": self.rotation,
            "rejected": self.rejected,
            "residual_m": self.residual_m,
            "residual_rad": self.residual_rad,
        }
        for name, array in arrays.items():
            if array.shape != shape:
                raise ValueError(f"{name} must be {shape}, got {array.shape}")
            read_only(array)
        for weights in (self.translation, self.rotation):
            total = weights.sum(axis=1)
            if not ((np.abs(total - 1.0) < 1e-9) | (total == 0.0)).all() or (weights < 0.0).any():
                raise ValueError("weights must not be negative, and sum to 1 or be all 0")
