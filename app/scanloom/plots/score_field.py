"""What a similarity heatmap is made of: the field and the marks."""

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
