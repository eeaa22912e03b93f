"""The offset (u, v) of one frame: anywhere, and near where the recording expects it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fusion_core.alignment.curves import (
    CurveSampling,
    curve_samples_m,
    sample_curve,
)
from fusion_core.alignment.search import Peak, find_peak
from fusion_core.alignment.similarity import Metric, SimilarityField
from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.errors import AlignmentFailed
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.row_search import (
    METRICS,
    SearchedRows,
    rows_to_search,
    search_rows,
    search_windows,
)
from fusion_core.workflows.fuse.settings import ChainSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetSearch:
    """The fields of one frame, and each metric's peak with the prior (``peaks``) and without it
    (``peaks_without_prior``). A metric without a peak is absent. The images of a
    panorama share one search.

    ``curve_m``: (Psi,) and ``rows_m``: (H, W) samples that were compared, NaN where missing.
    """

    curve_m: FloatArray
    rows_m: FloatArray
    fields: dict[Metric, SimilarityField]
    peaks: dict[Metric, Peak]
    peaks_without_prior: dict[Metric, Peak]


NO_SEARCH = OffsetSearch(
    curve_m=np.empty(0), rows_m=np.empty((0, 0)), fields={}, peaks={}, peaks_without_prior={}
)
"""Of a frame that was not searched."""


def search_offset(
    scan: LaserScan,
    curve: CurveSampling,
    rows_m: FloatArray,
    prior_u: float,
    settings: ChainSettings,
) -> OffsetSearch:
    """Search one frame. ``rows_m``: (H, W) samples of its rows, on which ``prior_u`` counts."""
    rows = rows_to_search(rows_m, settings)
    fields = search_rows(scan, curve, rows, settings)
    alone = _peaks(fields, settings, None)
    near = alone
    metric = settings.search.metric
    expected = False
    if settings.search.use_prior:
        half_width = settings.search.prior_samples
        window = (prior_u - half_width, prior_u + half_width)
        near = _peaks(fields, settings, prior_u)
        near = _refine_to_subsample(near, scan, curve, rows, window, METRICS, settings)
        expected = (
            metric in alone
            and metric in near
            and abs(curve.difference(alone[metric].u, prior_u)) <= half_width
        )
    if expected:
        # The peak without the prior lies where the prior expects it: one refinement serves both.
        alone[metric] = max(alone[metric], near[metric], key=lambda peak: peak.score)
    elif metric in alone:
        u = alone[metric].u
        window = (u - 1.0, u + 1.0)
        alone = _refine_to_subsample(alone, scan, curve, rows, window, (metric,), settings)
    peaks = near if settings.search.use_prior else alone
    return OffsetSearch(
        curve_m=curve_samples_m(scan, curve),
        rows_m=rows_m,
        fields=fields,
        peaks=peaks,
        peaks_without_prior=alone,
    )


def _refine_to_subsample(
    peaks: dict[Metric, Peak],
    scan: LaserScan,
    whole: CurveSampling,
    rows: SearchedRows,
    between: tuple[float, float],
    metrics: Sequence[Metric],
    settings: ChainSettings,
) -> dict[Metric, Peak]:
    """The peaks, or better ones at offsets between two whole samples.

    An offset of half a sample blurs every edge of the curve against the row's, and rows far from
    the true one may then fit as well: so the curve is sampled again a fraction of a sample further
    right, over the few samples of the window.
    """
    best = dict(peaks)
    if settings.sampling.by == "index":
        return best
    windows = [
        window
        for part in range(1, settings.search.sub_samples)
        if (
            window := _window(
                scan, whole, rows, between, part / settings.search.sub_samples, settings
            )
        )
    ]
    # Nearly always all are of one size, and one comparison serves them all.
    for size in sorted({window.beams.size for window in windows}):
        group = [window for window in windows if window.beams.size == size]
        beams = np.stack([window.beams for window in group])
        found = search_windows(scan, beams, rows, settings, metrics)
        for window, fields in zip(group, found, strict=True):
            for metric, peak in _peaks(fields, settings, None).items():
                if metric not in best or peak.score > best[metric].score:
                    coarse = peaks.get(metric, peak)
                    best[metric] = replace(
                        coarse,
                        u=whole.on_curve(peak.u + window.first_u),
                        v=peak.v,
                        score=peak.score,
                        overlap=peak.overlap,
                    )
    return best


class _Window(NamedTuple):
    """A piece of the curve, sampled between two whole samples: ``beams`` (N,), from the offset
    ``first_u`` on."""

    beams: IntArray
    first_u: float


def _window(
    scan: LaserScan,
    whole: CurveSampling,
    rows: SearchedRows,
    between: tuple[float, float],
    shift: float,
    settings: ChainSettings,
) -> _Window | None:
    """The offsets ``between`` that lie ``shift`` of a sample to the right of a whole one; None
    where there are none."""
    width = rows.samples.width
    first, last = int(np.ceil(between[0] - shift)), int(np.floor(between[1] - shift))
    if whole.turn_samples is None:
        curve = sample_curve(scan, settings.sampling, shift=shift)
        first, last = max(0, first), min(curve.beams.size - width, last)
        if last < first:
            return None
        return _Window(curve.beams[first : last + width], first + shift)
    # A full circle may be sampled from any place on.
    span = max(0, last - first) + width
    curve = sample_curve(scan, settings.sampling, shift=first + shift, width=span)
    return _Window(curve.beams[:span], first + shift)


def _peaks(
    fields: dict[Metric, SimilarityField], settings: ChainSettings, prior_u: float | None
) -> dict[Metric, Peak]:
    peaks = {}
    for metric, field in fields.items():
        try:
            peaks[metric] = find_peak(
                field, settings.search, prior_u=prior_u, refine=settings.search.sub_samples > 1
            )
        except AlignmentFailed:
            continue
    return peaks
