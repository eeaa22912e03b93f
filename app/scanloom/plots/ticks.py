"""Round values along an axis, and their labels."""

import numpy as np

_TIME_UNITS = ((3600.0, "h"), (60.0, "min"))


def ticks_between(low: float, high: float, max_count: int) -> list[float]:
    """At most ``max_count`` values from ``low`` to ``high`` at steps of 1, 2 or 5 times 10^k."""
    span = high - low
    if not span > 0.0:
        return [low]
    power = 10.0 ** np.floor(np.log10(span / max(max_count, 1)))
    for factor in (1.0, 2.0, 5.0, 10.0, 20.0):
        step = factor * power
        first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
        if last - first + 1 <= max_count:
            break
    return [float(f"{number * step:.12g}") for number in range(first, last + 1)]


def whole_ticks_between(low: float, high: float, max_count: int) -> list[float]:
    """Those of ``ticks_between`` that are whole."""
    return [value for value in ticks_between(low, high, max_count) if value == round(value)]


def time_ticks(first_s: float, last_s: float, max_count: int) -> list[tuple[float, str]]:
    """At most ``max_count`` times in seconds with their labels: seconds, or minutes or hours where
    there are at least five of them."""
    unit_s, unit = next(
        ((size_s, name) for size_s, name in _TIME_UNITS if last_s - first_s >= 5.0 * size_s),
        (1.0, "s"),
    )
    return [
        (value * unit_s, f"{number_label(value)} {unit}")
        for value in ticks_between(first_s / unit_s, last_s / unit_s, max_count)
    ]


def number_label(value: float) -> str:
    """A tick's label, short and with a true minus."""
    small = 0.0 < abs(value) < 1e-3
    text = np.format_float_scientific(value, trim="-", exp_digits=1) if small else f"{value:g}"
    return text.replace("-", "−")


def distinct_limits(low: float, high: float) -> tuple[float, float]:
    """Limits of a scale that differ even where all values are one."""
    least = 1e-6 * max(abs(low), abs(high), 1e-3)
    return (low, high) if high - low > least else (low - 0.5, high + 0.5)
