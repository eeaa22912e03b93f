"""The seven statistics in which trajectory errors are usually reported."""

from dataclasses import asdict, dataclass
from typing import Self

import numpy as np

from fusion_core.model.conventions import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorStatistics:
    """Statistics in the unit of the errors, ``variance`` in its square.

    ``variance`` and ``std`` divide by N, not N - 1.
    """

    min: float
    max: float
    mean: float
    median: float
    variance: float
    std: float
    rmse: float

    @classmethod
    def of(cls, errors: FloatArray) -> Self:
        """The statistics of (N,) errors, N >= 1."""
        return cls(
            min=float(errors.min()),
            max=float(errors.max()),
            mean=float(errors.mean()),
            median=float(np.median(errors)),
            variance=float(errors.var()),
            std=float(errors.std()),
            rmse=float(np.sqrt(np.mean(errors**2))),
        )

    def to_json(self) -> dict[str, float]:
        """The statistics by name."""
        return asdict(self)
