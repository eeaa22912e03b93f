"""Figures of maps over several seeds, as the benchmarks of whole sites print them."""

from typing import Any

import numpy as np


def number(value: float | None) -> float:
    """NaN for a measure of nothing."""
    return float("nan") if value is None else value


def percent(value: float | None) -> float:
    """A fraction in per cent, NaN for one of nothing."""
    return 100.0 * number(value)


def statistics(
    values: np.ndarray[Any, np.dtype[Any]], *, digits: int = 2, more_is_better: bool = False
) -> str:
    """Mean ± standard deviation (worst) of those that are known; "-" where none is."""
    known = values[np.isfinite(values)]
    if not known.size:
        return "-"
    sd = f"{known.std(ddof=1):.{digits}f}" if known.size > 1 else "-"
    worst = known.min() if more_is_better else known.max()
    return f"{known.mean():.{digits}f} ± {sd} ({worst:.{digits}f})"
