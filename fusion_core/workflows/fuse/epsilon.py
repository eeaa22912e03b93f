"""The threshold epsilon of eq. (6) in its three units, and what it is in a frame."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.workflows.fuse.align import RecordingAlignment
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_match import FrameMatch
from fusion_core.workflows.fuse.settings import PRESETS

EpsilonUnit = Literal["sigma", "E", "m"]
EPSILON_UNITS: tuple[EpsilonUnit, ...] = get_args(EpsilonUnit)

# For a unit whose length is not known in a frame: the presets' values, and 10 cm.
_DEFAULT_EPSILON: dict[EpsilonUnit, float] = {
    "m": 0.10,
    **{preset.noise.epsilon_unit: preset.noise.epsilon for preset in PRESETS.values()},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class EpsilonInFrame:
    """``median_m``, ``min_m``, ``max_m``: threshold over the ``compared`` pairs with both values;
    ``beyond`` of these disagree by more than their threshold. ``E_m``: E. NaN where the frame has
    none."""

    median_m: float
    min_m: float
    max_m: float
    beyond: int
    compared: int
    E_m: float

    @property
    def band_m(self) -> tuple[float, float]:
        """The paper's band [E, sqrt(2) E], in which both recalls are high (its Fig. 6)."""
        return self.E_m, float(np.sqrt(2.0)) * self.E_m


def unit_lengths_m(match: FrameMatch, alignment: RecordingAlignment) -> dict[EpsilonUnit, float]:
    """The length of each unit in a frame: the median sigma over its pairs, its E, and 1.

    A unit that has none, as E without a registration, is absent.
    """
    lengths: dict[EpsilonUnit, float] = {"m": 1.0}
    found = match.registration
    if found is not None and np.isfinite(found.mean_error_m) and found.mean_error_m > 0.0:
        lengths["E"] = found.mean_error_m
    ranges_m = match.correspondence.lidar_range_m[np.isfinite(match.correspondence.residual_m)]
    if ranges_m.size:
        lengths["sigma"] = float(np.median(alignment.scale.sigma_at(ranges_m)))
    return lengths


def convert_epsilon(
    epsilon: float, old: EpsilonUnit, new: EpsilonUnit, lengths_m: dict[EpsilonUnit, float]
) -> float:
    """Epsilon in another unit with about the same length; the default where a unit has none."""
    if old == new:
        return epsilon
    if old not in lengths_m or new not in lengths_m:
        return _DEFAULT_EPSILON[new]
    return epsilon * lengths_m[old] / lengths_m[new]


def measure_epsilon(frame: FusedFrame) -> EpsilonInFrame:
    """The threshold in a frame, and how many pairs exceed it."""
    compared = np.isfinite(frame.match.correspondence.residual_m)
    epsilon_m: FloatArray = frame.classes.epsilon_m[compared]
    E_m = (
        float("nan") if frame.match.registration is None else frame.match.registration.mean_error_m
    )
    known = bool(epsilon_m.size)
    return EpsilonInFrame(
        median_m=frame.epsilon_m,
        min_m=float(epsilon_m.min()) if known else float("nan"),
        max_m=float(epsilon_m.max()) if known else float("nan"),
        beyond=int((np.abs(frame.match.correspondence.residual_m[compared]) > epsilon_m).sum()),
        compared=int(compared.sum()),
        E_m=E_m,
    )
