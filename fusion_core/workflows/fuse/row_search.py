"""The fields of one scan's curve over the rows of an image."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np

from fusion_core.alignment.centred_curves import CentredCurves, centre
from fusion_core.alignment.curves import CurveSampling
from fusion_core.alignment.similarity import (
    Metric,
    SimilarityField,
    similarity_fields,
    similarity_of_windows,
)
from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.errors import SettingsError
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.settings import ChainSettings

METRICS: tuple[Metric, ...] = get_args(Metric)


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchedRows:
    """The rows of an image from row ``first`` on, ready to be compared with several curves."""

    first: int
    samples: CentredCurves


def rows_to_search(rows_m: FloatArray, settings: ChainSettings) -> SearchedRows:
    """``rows_m``: (H, W) samples of all rows, NaN where missing.

    Raises SettingsError where the searched band holds no row.
    """
    height = rows_m.shape[0]
    first = max(settings.sampling.row_first, round((1.0 - settings.sampling.row_band) * height))
    if first >= height:
        raise SettingsError(
            f"sampling.row_first = {settings.sampling.row_first}: the depth images have {height} "
            "rows.",
            advice="Lower it, or raise sampling.row_band.",
        )
    searched_m = rows_m[first:]
    if not settings.search.mask_holes:
        searched_m = np.nan_to_num(searched_m, nan=0.0)
    return SearchedRows(first=first, samples=centre(searched_m))


def search_rows(
    scan: LaserScan,
    curve: CurveSampling,
    rows: SearchedRows,
    settings: ChainSettings,
    metrics: Iterable[Metric] = METRICS,
) -> dict[Metric, SimilarityField]:
    """The fields of one frame over all its rows; rows outside the searched band have no score.

    Raises AlignmentFailed for too short a curve.
    """
    curve_m = _searched_samples_m(scan, curve.beams, settings)
    fields = similarity_fields(
        curve_m,
        rows.samples,
        metrics=tuple(metrics),
        min_overlap=settings.search.min_overlap,
        # At a full circle no row reaches beyond an end.
        partial=curve.turn_samples is None
        and (settings.search.allow_partial or rows.samples.width > curve_m.size),
        turn_samples=curve.turn_samples,
    )
    return {metric: _pad_rows_above(field, rows.first) for metric, field in fields.items()}


def search_windows(
    scan: LaserScan,
    beams: IntArray,
    rows: SearchedRows,
    settings: ChainSettings,
    metrics: Sequence[Metric],
) -> list[dict[Metric, SimilarityField]]:
    """The fields of K short pieces of the curve, (K, N) ``beams`` of at least a row's samples."""
    pieces = similarity_of_windows(
        _searched_samples_m(scan, beams, settings),
        rows.samples,
        metrics=metrics,
        min_overlap=settings.search.min_overlap,
    )
    return [
        {metric: _pad_rows_above(field, rows.first) for metric, field in fields.items()}
        for fields in pieces
    ]


def _searched_samples_m(scan: LaserScan, beams: IntArray, settings: ChainSettings) -> FloatArray:
    samples_m = scan.ranges_m[beams]
    return samples_m if settings.search.mask_holes else np.nan_to_num(samples_m, nan=0.0)


def _pad_rows_above(field: SimilarityField, first: int) -> SimilarityField:
    """The field with ``first`` rows without scores above it, so that v counts from the image's
    top."""
    if first == 0:
        return field
    above = np.full((first, field.scores.shape[1]), np.nan)
    return SimilarityField(
        scores=np.vstack([above, field.scores]),
        overlap=np.vstack([np.zeros_like(above), field.overlap]),
        u_first=field.u_first,
        turn_samples=field.turn_samples,
    )
