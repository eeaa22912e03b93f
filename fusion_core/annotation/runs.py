"""Runs: neighbouring samples of a capture that have one label.

In a scan a run is a stretch of beams. In an image it is a region: pixels above and below each other
are neighbours too, diagonal ones are not.
"""

import numpy as np

from fusion_core.annotation.aligned_layers import AlignedLabels
from fusion_core.model.conventions import BoolArray, IntArray


def number_runs(aligned: AlignedLabels, values: IntArray, within: BoolArray) -> IntArray:
    """(N,) the number of the run that each sample belongs to, -1 outside ``within``.

    ``values``: (N,) what the samples of a run have in common. ``within``: (N,). Runs are numbered
    from 0 in the order of their first samples.
    """
    numbers = np.full(values.shape, -1)
    numbers[within] = _number_all(
        aligned,
        aligned.capture[within],
        aligned.row[within],
        aligned.column[within],
        values[within],
    )
    return numbers


def _number_all(
    aligned: AlignedLabels, capture: IntArray, row: IntArray, column: IntArray, values: IntArray
) -> IntArray:
    if not values.size:
        return np.zeros(0, dtype=np.int64)
    sizes = np.array([one.rows * one.columns for one in aligned.captures])
    columns = np.array([one.columns for one in aligned.captures])[capture]
    # One number for each place of all captures, rising with the samples.
    place = (np.cumsum(sizes) - sizes)[capture] + row * columns + column
    starts = np.ones(values.shape, dtype=np.bool_)
    starts[1:] = (np.diff(place) != 1) | (np.diff(values) != 0) | (column[1:] == 0)
    numbers: IntArray = np.cumsum(starts) - 1
    if (row == 0).all():
        return numbers
    # Loading these takes a quarter of a second, for which whoever opens the workbench would wait.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    rows = np.array([one.rows for one in aligned.captures])[capture]
    below = np.minimum(np.searchsorted(place, place + columns), place.size - 1)
    # Without the rows the sample below the last row would lie in the next capture.
    joined = (place[below] == place + columns) & (row + 1 < rows) & (values[below] == values)
    upper, lower = numbers[joined], numbers[below[joined]]
    count = int(numbers[-1]) + 1
    edges = coo_array((np.ones(upper.size, dtype=np.int8), (upper, lower)), shape=(count, count))
    regions = connected_components(edges, directed=False)[1]
    # SciPy does not say in which order it numbers them.
    _, first, region = np.unique(regions[numbers], return_index=True, return_inverse=True)
    order: IntArray = np.argsort(np.argsort(first))
    return order[region]
