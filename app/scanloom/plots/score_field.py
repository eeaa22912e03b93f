"""What a similarity heatmap is made of: the field, what u means in degrees, and the marks."""

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from fusion_core.model.conventions import FloatArray


class ScoreField(Protocol):
    """Scores of H depth rows at U offsets: ``scores`` (H, U), NaN where there is none; ``u_first``
    is the offset of column 0."""

    @property
    def scores(self) -> FloatArray: ...
    @property
    def u_first(self) -> int: ...


@dataclass(frozen=True, slots=True)
class AzimuthAxis:
    """What offsets are in degrees: ``first_deg`` at u = 0, ``step_deg`` more for each sample.

    ``step_deg`` is negative where azimuth falls to the right, as it does along a curve.
    """

    first_deg: float
    step_deg: float

    def __post_init__(self) -> None:
        if not np.isfinite([self.first_deg, self.step_deg]).all() or self.step_deg == 0.0:
            raise ValueError(f"an axis needs finite degrees and a step, got {self}")

    @classmethod
    def of_curve(cls, left_rad: float, step_rad: float) -> "AzimuthAxis":
        """That of a sampled LiDAR curve, whose azimuth falls by ``step_rad`` a sample."""
        return cls(float(np.rad2deg(left_rad)), -float(np.rad2deg(step_rad)))

    def azimuth_deg(self, u: float) -> float:
        """The azimuth at an offset."""
        return self.first_deg + self.step_deg * u

    def offset_of(self, azimuth_deg: float) -> float:
        """Inverse of :meth:`azimuth_deg`."""
        return (azimuth_deg - self.first_deg) / self.step_deg


MarkKind = Literal["peak", "runner_up", "prior", "picked"]


@dataclass(frozen=True, slots=True)
class Mark:
    """A place in the field. ``v`` is None for a line through all rows.

    A mark with a NaN is none: a field may have no runner-up.
    """

    kind: MarkKind
    u: float
    v: float | None = None

    @property
    def exists(self) -> bool:
        """Whether there is a place to draw it at."""
        return bool(np.isfinite(self.u)) and (self.v is None or bool(np.isfinite(self.v)))
