"""The nearest point of a 2D sweep, by angle and jump tables (Censi 2008, "smart search").

A sweep is a curve r(θ), so the nearest point of a query lies in about the same direction. The
search goes from that direction to both sides, jumps over beams that cannot be nearer, and stops
where no beam can be. The result is exact and visits a few beams only; a k-d tree would not use the
order.
"""

from typing import NamedTuple

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.sweep import MAX_SWEEP_RAD


class PolarScan(NamedTuple):
    """The M valid beams of a sweep, counter-clockwise, in the sensor's frame.

    ``beam``: (M,) their indices in the sweep as given. ``range_m``, ``cos``, ``sin``: (M,).
    ``first_in_slot``: (N + 1,) for each beam of the whole sweep the first valid one at or after
    its angle; the last entry is M. ``start_rad``: angle of slot 0; ``step_rad``: positive.
    ``farther_up``, ``nearer_up``, ``farther_down``, ``nearer_down``: (M,) steps, up being
    counter-clockwise, to the next beam with a larger or smaller range; M where there is none.
    The four tables close the circle: after the last beam comes the first.
    """

    beam: IntArray
    range_m: FloatArray
    cos: FloatArray
    sin: FloatArray
    first_in_slot: IntArray
    start_rad: float
    step_rad: float
    farther_up: IntArray
    nearer_up: IntArray
    farther_down: IntArray
    nearer_down: IntArray


def make_polar_scan(
    ranges_m: FloatArray, angle_min_rad: float, angle_increment_rad: float
) -> PolarScan:
    """Prepare a sweep (N,) for ``find_nearest``. A beam that is not finite and positive is missing,
    and so is one beyond a full turn.

    Raises ValueError for wrong shapes and angles, and for a sweep of much more than a full turn.
    """
    ranges_m = np.asarray(ranges_m, dtype=np.float64)
    if ranges_m.ndim != 1:
        raise ValueError(f"ranges_m must be (N,), got {ranges_m.shape}")
    step_rad = abs(angle_increment_rad)
    if not np.isfinite(angle_min_rad) or not np.isfinite(step_rad) or step_rad == 0.0:
        raise ValueError(
            f"angles must be finite and the increment non-zero, got {angle_min_rad:g}, "
            f"{angle_increment_rad:g}"
        )
    if step_rad * (ranges_m.size - 1) > MAX_SWEEP_RAD:
        raise ValueError(f"{ranges_m.size} beams, {step_rad:g} rad apart, exceed a full turn")
    # The first beam may be repeated at the end of the circle. Any beams after it see the start
    # again, or are due to a rounded increment.
    ranges_m = ranges_m[: int((2.0 * np.pi) / step_rad + 0.5) + 1]
    clockwise = angle_increment_rad < 0.0
    start_rad = angle_min_rad + angle_increment_rad * (ranges_m.size - 1) * clockwise
    # Copied: for arrays that are read-only or strided it would be compiled once more.
    prepared: PolarScan = _prepare(
        np.array(ranges_m, np.float64), clockwise, float(start_rad), float(step_rad)
    )
    return prepared


@compiled()
def _prepare(ranges_m: FloatArray, clockwise: bool, start_rad: float, step_rad: float) -> PolarScan:
    count = ranges_m.size
    beam = np.empty(count, dtype=np.int64)
    range_m, cos, sin = np.empty(count), np.empty(count), np.empty(count)
    first_in_slot = np.empty(count + 1, dtype=np.int64)
    valid = 0
    for slot in range(count):
        first_in_slot[slot] = valid
        index = count - 1 - slot if clockwise else slot
        value = ranges_m[index]
        if np.isfinite(value) and value > 0.0:
            angle = start_rad + slot * step_rad
            beam[valid], range_m[valid] = index, value
            cos[valid], sin[valid] = np.cos(angle), np.sin(angle)
            valid += 1
    first_in_slot[count] = valid
    range_m = range_m[:valid].copy()
    return PolarScan(
        beam[:valid].copy(),
        range_m,
        cos[:valid].copy(),
        sin[:valid].copy(),
        first_in_slot,
        start_rad,
        step_rad,
        _steps_to_next(range_m, 1.0, 1),
        _steps_to_next(range_m, -1.0, 1),
        _steps_to_next(range_m, 1.0, -1),
        _steps_to_next(range_m, -1.0, -1),
    )


@compiled()
def _steps_to_next(range_m: FloatArray, sign: float, direction: int) -> IntArray:
    """(M,) steps in ``direction`` to the next beam with sign · range larger; M where none is."""
    count = range_m.size
    steps = np.full(count, count, dtype=np.int64)
    stack = np.empty(2 * count, dtype=np.int64)
    depth = 0
    # Twice round the circle, so that each beam sees all others after it.
    for place in range(2 * count):
        value = sign * range_m[place % count if direction > 0 else -1 - place % count]
        while depth > 0:
            earlier = stack[depth - 1]
            index = earlier % count if direction > 0 else count - 1 - earlier % count
            if sign * range_m[index] >= value:
                break
            depth -= 1
            if earlier < count:
                steps[index] = min(steps[index], place - earlier)
        stack[depth] = place
        depth += 1
    return steps


@compiled()
def find_nearest(
    scan: PolarScan, x_m: float, y_m: float, squared_limit_m2: float
) -> tuple[int, float]:
    """Index of the valid beam nearest to a point in the sensor's frame, and its squared distance.

    -1 and the limit where none is nearer than that.
    """
    count = scan.range_m.size
    best, best_squared = -1, squared_limit_m2
    if count == 0:
        return best, best_squared
    squared = x_m * x_m + y_m * y_m
    turned = np.arctan2(y_m, x_m) - scan.start_rad
    if turned < 0.0 or turned >= 2.0 * np.pi:
        turned %= 2.0 * np.pi
    slot = int(np.ceil(turned / scan.step_rad))
    above = scan.first_in_slot[min(slot, scan.first_in_slot.size - 1)]

    index = above if above < count else 0
    travelled = 0
    while travelled < count:
        along = x_m * scan.cos[index] + y_m * scan.sin[index]
        # No point in this direction or farther round is nearer than the foot on this ray.
        if (squared - along * along if along > 0.0 else squared) >= best_squared:
            break
        range_m = scan.range_m[index]
        here = squared + range_m * (range_m - 2.0 * along)
        if here < best_squared:
            best, best_squared = index, here
        # Short of the foot, a beam farther round is nearer only if it is longer; beyond it, only
        # if it is shorter.
        steps = scan.farther_up[index] if range_m < along else scan.nearer_up[index]
        travelled += steps
        index += steps
        if index >= count:
            index -= count

    index = above - 1 if above > 0 else count - 1
    travelled = 0
    while travelled < count:
        along = x_m * scan.cos[index] + y_m * scan.sin[index]
        if (squared - along * along if along > 0.0 else squared) >= best_squared:
            break
        range_m = scan.range_m[index]
        here = squared + range_m * (range_m - 2.0 * along)
        if here < best_squared:
            best, best_squared = index, here
        steps = scan.farther_down[index] if range_m < along else scan.nearer_down[index]
        travelled += steps
        index -= steps
        if index < 0:
            index += count
    return best, max(best_squared, 0.0)
