"""A robust scale of a few values, and how large a deviation from them is by chance.

The scale is Q_n (Rousseeuw and Croux, 1993, eq. 3.7): the k-th smallest distance of two values,
k = h (h - 1) / 2 with h = n // 2 + 1. Half of the values may be anything; of normal values it uses
82 % of the information, where the median absolute deviation uses 37 %.
"""

import numpy as np
from scipy import special

from fusion_core.model.conventions import FloatArray

# 1 / (sqrt(2) Phi^-1(5/8)): Q_n of a normal distribution is its standard deviation.
_CONSISTENCY = 1.0 / (np.sqrt(2.0) * float(special.ndtri(5.0 / 8.0)))
# What makes it unbiased for 2 to 9 values (Croux and Rousseeuw, 1992).
_SMALL_SAMPLE = (0.399, 0.994, 0.512, 0.844, 0.611, 0.857, 0.669, 0.872)
_EFFICIENCY = 0.8227
# Of more values as many order statistics, evenly spread, have the same spread.
_VALUES_MAX = 200


def qn_scale(ordered: FloatArray) -> float:
    """Q_n of (n,) values in ascending order, n >= 2: their standard deviation if normal."""
    if ordered.size > _VALUES_MAX:
        places = np.linspace(0, ordered.size - 1, _VALUES_MAX)
        ordered = ordered[np.rint(places).astype(np.int64)]
    n = ordered.size
    first, second = np.triu_indices(n, 1)
    k = (n // 2 + 1) * (n // 2) // 2
    distance = np.partition(ordered[second] - ordered[first], k - 1)[k - 1]
    large = n / (n + 1.4) if n % 2 else n / (n + 3.8)
    unbiased = _SMALL_SAMPLE[n - 2] if n < 10 else large
    return float(_CONSISTENCY * unbiased * distance)


def z_threshold(probability: float, others: int, *, two_sided: bool) -> float:
    """The z that a normal value exceeds with at most this probability.

    z is its distance from the median of ``others`` values of the same distribution over their Q_n.
    The median itself varies by pi / (2 n) of the variance. Q_n has the degrees of freedom of its
    asymptotic efficiency, fewer in small samples; n / (n + 5) is on the safe side for all n >= 5.
    """
    freedom = _EFFICIENCY * (others - 1) * others / (others + 5)
    tail = probability / 2.0 if two_sided else probability
    spread = np.sqrt(1.0 + np.pi / (2.0 * others))
    return float(-spread * special.stdtrit(freedom, tail))
