"""Xu 2024 §2.2, eq. (1): the peak (u, v) of the similarity field, of one frame or of a recording.

Eq. (1) prints ``max[arg min ...]``; what the text and Fig. 4 do is the arg max over (u, v).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fusion_core.alignment.parabola import parabola_offset
from fusion_core.alignment.similarity import Metric, SimilarityField
from fusion_core.compiled import compiled
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import AlignmentFailed
from fusion_core.settings import StageSettings, setting


class SearchSettings(StageSettings):
    """How the field is scored and its peak picked."""

    metric: Literal["pearson", "cosine", "inverse_cosine", "euclidean"] = setting(
        "euclidean", "Score that decides on (u, v); all four are reported"
    )
    min_overlap: float = setting(
        0.5, "Least fraction of a row's samples valid on both sides", ge=1e-6, le=1.0
    )
    allow_partial: bool = setting(
        False, "Let the row extend beyond the ends of the LiDAR curve", formerly="partial"
    )
    mask_holes: bool = setting(True, "Leave holes out (published: holes count as zeros)")
    sub_samples: int = setting(
        4,
        "Places within a sample at which a frame's u is tried; 1: whole samples and rows alone "
        "(published)",
        ge=1,
        le=8,
    )
    prior_samples: int = setting(
        1, "How far a frame's u may lie from the recording's", unit="samples", ge=0, le=1_000
    )
    use_prior: bool = setting(True, "Search each frame around the recording's u")
    runner_up_distance: int = setting(
        4, "Least distance in u of the runner-up from the peak", unit="samples", ge=1, le=1_000
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Peak:
    """The best offset. ``u`` and ``v`` may be refined below a sample by a parabola.

    ``ratio`` = score / runner-up's score, NaN where there is no positive runner-up.
    """

    u: float
    v: float
    score: float
    ratio: float
    overlap: float
    runner_up_u: float
    runner_up_v: float


def find_peak(
    field: SimilarityField,
    settings: SearchSettings,
    *,
    prior_u: float | None = None,
    refine: bool = True,
) -> Peak:
    """arg max of the field, within ``prior_samples`` of ``prior_u`` where one is given; refined
    below a sample, or as printed in eq. (1) a whole sample and row.

    Raises AlignmentFailed where the field has no score there.
    """
    # Half a sample: with prior_samples = 0 the nearest whole offset is still allowed.
    reach = np.inf if prior_u is None else max(float(settings.prior_samples), 0.5)
    row, column, other_row, other = _highest_cells(
        field.scores,
        0.0 if prior_u is None else prior_u - field.u_first,
        reach,
        settings.runner_up_distance,
        np.inf if field.turn_samples is None else field.turn_samples,
    )
    if row < 0:
        raise AlignmentFailed(
            "no offset (u, v) has enough samples valid on both sides.",
            advice="Lower search.min_overlap, or check that both sensors see the same side.",
        )
    score = float(field.scores[row, column])
    runner_u = runner_v = runner_score = float("nan")
    if other_row >= 0:
        runner_u, runner_v = float(field.u_first + other), float(other_row)
        runner_score = float(field.scores[other_row, other])
    u, v = float(field.u_first + column), float(row)
    if refine:
        u += _offset_to_the_side(field, row, column)
        v += parabola_offset(field.scores[:, column], row)
    return Peak(
        u=u,
        v=v,
        score=score,
        ratio=score / runner_score if runner_score > 0.0 else float("nan"),
        overlap=float(field.overlap[row, column]),
        runner_up_u=runner_u,
        runner_up_v=runner_v,
    )


@compiled()
def _highest_cells(
    scores: FloatArray, about: float, reach: float, away: float, turn: float
) -> tuple[int, int, int, int]:
    """Row and column of the highest score among the columns at most ``reach`` from the column
    ``about``, and of the highest one among those at least ``away`` from that; -1 where there is
    none. Of equal ones the first column, and in it the first row. ``turn``: the columns of a full
    circle, infinite where the curve has ends."""
    height, width = scores.shape
    best, best_row = np.full(width, -np.inf), np.zeros(width, dtype=np.int64)
    for v in range(height):
        for u in range(width):
            # NaN compares false.
            is_better = scores[v, u] > best[u]
            best[u] = scores[v, u] if is_better else best[u]
            best_row[u] = v if is_better else best_row[u]
    column = _highest_column(best, about, 0.0, reach, turn)
    if column < 0:
        return -1, -1, -1, -1
    other = _highest_column(best, float(column), away, np.inf, turn)
    return best_row[column], column, best_row[other] if other >= 0 else -1, other


@compiled()
def _highest_column(
    best: FloatArray, about: float, nearest: float, farthest: float, turn: float
) -> int:
    """The column of the highest finite value from ``nearest`` to ``farthest`` columns away."""
    column = -1
    for u in range(best.size):
        off = u - about
        if turn < np.inf:
            off -= turn * np.rint(off / turn)
        allowed = nearest <= abs(off) <= farthest and np.isfinite(best[u])
        if allowed and (column < 0 or best[u] > best[column]):
            column = u
    return column


def _offset_to_the_side(field: SimilarityField, row: int, column: int) -> float:
    """The parabola's offset in u; of a full circle, the first and the last column are neighbours
    where a whole number of samples makes the turn."""
    along_row = field.scores[row]
    is_closed = field.turn_samples is not None and abs(field.turn_samples - along_row.size) < 1e-6
    if is_closed and column in (0, along_row.size - 1):
        return parabola_offset(np.take(along_row, column + np.arange(-1, 2), mode="wrap"), 1)
    return parabola_offset(along_row, column)


class MeanField:
    """The mean field of many frames, in memory that does not grow with their number.

    A cell has a mean only where at least half of the frames have a score.
    """

    def __init__(self) -> None:
        self._sums: dict[Metric, FloatArray] = {}
        self._counts: dict[Metric, FloatArray] = {}
        self._overlap: FloatArray | None = None
        self._u_first = 0
        self._turn_samples: float | None = None
        self.frames = 0

    def add(self, fields: dict[Metric, SimilarityField]) -> None:
        """Add the fields of one frame."""
        self.frames += 1
        for metric, field in fields.items():
            valid = np.isfinite(field.scores)
            if metric not in self._sums:
                self._sums[metric] = np.zeros(field.scores.shape)
                self._counts[metric] = np.zeros(field.scores.shape)
                self._u_first, self._turn_samples = field.u_first, field.turn_samples
            self._sums[metric] += np.where(valid, field.scores, 0.0)
            self._counts[metric] += valid
        overlap = next(iter(fields.values())).overlap
        self._overlap = overlap.copy() if self._overlap is None else self._overlap + overlap

    def mean(self, metric: Metric) -> SimilarityField:
        """The mean field. Raises AlignmentFailed where no frame was added."""
        if self._overlap is None:
            raise AlignmentFailed(
                "no depth image has a scan close enough in time",
                advice="Raise time.max_gap_ms, or check the topics and their clocks.",
            )
        counts = self._counts[metric]
        enough = counts * 2 >= max(self.frames, 1)
        scores = np.full(counts.shape, np.nan)
        np.divide(self._sums[metric], counts, out=scores, where=enough & (counts > 0))
        return SimilarityField(
            scores=scores,
            overlap=self._overlap / self.frames,
            u_first=self._u_first,
            turn_samples=self._turn_samples,
        )
