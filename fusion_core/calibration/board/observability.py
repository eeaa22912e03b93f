"""Which parameters of a pose the data determine, and the pose with the others as they were."""

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.extrinsics import POSE_PARAMETERS


def standard_deviations(information: FloatArray) -> FloatArray:
    """(6,) one for each of POSE_PARAMETERS, inf where the information (6, 6) leaves it open."""
    scale = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    # Below this a direction is open but for rounding.
    values = np.where(values > 1e-12 * values.max(), values, 0.0)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        # A direction that is open counts where it has a part in the parameter.
        spread = np.where(np.abs(vectors) > 1e-6, vectors**2 / values, 0.0).sum(axis=1)
        sd: FloatArray = np.sqrt(spread) / scale
    return sd


def unobservable_parameters(information: FloatArray, limits: FloatArray) -> tuple[str, ...]:
    """The parameters whose standard deviation exceeds its limit, in the order of POSE_PARAMETERS.

    One at a time: holding the worst fixed may determine the others.
    """
    free = np.ones(len(POSE_PARAMETERS), dtype=np.bool_)
    while free.any():
        ratio = standard_deviations(information[np.ix_(free, free)]) / limits[free]
        worst = int(np.argmax(ratio))
        if ratio[worst] <= 1.0:
            break
        free[np.flatnonzero(free)[worst]] = False
    return tuple(name for name, is_free in zip(POSE_PARAMETERS, free, strict=True) if not is_free)


def observable_covariance(information: FloatArray, unobservable: tuple[str, ...]) -> FloatArray:
    """(6, 6) covariance of the others, NaN in the rows and columns of ``unobservable``."""
    free = np.array([name not in unobservable for name in POSE_PARAMETERS])
    covariance = np.full((len(POSE_PARAMETERS), len(POSE_PARAMETERS)), np.nan)
    covariance[np.ix_(free, free)] = np.linalg.inv(information[np.ix_(free, free)])
    return covariance
