"""Where between samples an extremum lies."""

import math

from fusion_core.model.conventions import FloatArray


def parabola_offset(values: FloatArray, best: int) -> float:
    """Offset in [-0.5, 0.5] of the extremum of the parabola through three neighbours of ``best``.

    0 at the ends, where a neighbour is missing, and on a slope, where ``best`` is no extremum.
    """
    if best == 0 or best == values.size - 1:
        return 0.0
    left, middle, right = values[best - 1 : best + 2].tolist()
    curvature = left - 2.0 * middle + right
    on_slope = (left - middle) * (right - middle) < 0.0
    if not math.isfinite(curvature) or curvature == 0.0 or on_slope:
        return 0.0
    return float(min(0.5, max(-0.5, 0.5 * (left - right) / curvature)))
