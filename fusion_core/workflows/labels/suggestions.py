"""Thresholds of the classes, fitted on a layer of labels.

Each setting is varied alone, the others as they are in use. What is scored is which samples become
burrs: noise is what a person calls a burr, or a hole though it has a value; real is what they call
good or conflict. Holes without a value have that class whatever the settings.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from fusion_core.alignment.time import TimeSettings
from fusion_core.denoising.noise_settings import NoiseSettings
from fusion_core.denoising.overruling import is_rejected
from fusion_core.evaluation.threshold_fit import ThresholdFit, ThresholdSweep, fit_threshold
from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray
from fusion_core.model.labels import Label
from fusion_core.workflows.fuse.align import RecordingAlignment
from fusion_core.workflows.fuse.frame import classify_match
from fusion_core.workflows.fuse.settings import ChainSettings
from fusion_core.workflows.labels.labelled_frames import LabelledFrame

_EPSILONS = {
    "sigma": np.geomspace(0.8, 12.0, 25),
    "E": np.geomspace(0.2, 6.0, 25),
    "m": np.geomspace(0.01, 1.0, 25),
}
# The values that are tried, besides the one in use; set by hand, well beyond what is sensible.
_TRIED: Mapping[str, tuple[float, ...]] = {
    "support_sigma": (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0),
    "slope_fraction": (0.0, 0.005, 0.01, 0.02, 0.03, 0.05, 0.1),
    "pixel_tolerance_fraction": (0.005, 0.01, 0.02, 0.03, 0.04, 0.06, 0.1),
    "burr_odds": (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0),
    "pixel_support": (1, 2, 3, 4, 6, 8, 12),
    "pixel_support_fraction": (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Suggestion:
    """A value for a setting of NoiseSettings; ``fit`` is None where the labels do not tell."""

    setting: str
    fit: ThresholdFit | None


def suggest_thresholds(
    frames: Iterable[LabelledFrame], alignment: RecordingAlignment, settings: ChainSettings
) -> tuple[Suggestion, ...]:
    """A suggestion for each threshold that decides which samples are burrs; epsilon is the first.

    One pass over ``frames``, of which none is kept.
    """
    noise = settings.noise
    sweeps = {name: _Sweep(noise, name, values) for name, values in _values_to_try(noise).items()}
    for frame in frames:
        for sweep in sweeps.values():
            sweep.add(frame, alignment, settings.time)
    return tuple(Suggestion(setting=name, fit=sweep.fit()) for name, sweep in sweeps.items())


def _values_to_try(noise: NoiseSettings) -> dict[str, FloatArray]:
    tried: dict[str, Iterable[float]] = {"epsilon": _EPSILONS[noise.epsilon_unit]}
    if noise.burr_criterion == "support":
        # Where the rougher side is the burr, no support is counted.
        tried |= _TRIED
    return {
        name: np.unique(np.append(np.array(list(values)), float(getattr(noise, name))))
        for name, values in tried.items()
    }


class _Sweep:
    """Counts of each scan under each value of one setting."""

    def __init__(self, noise: NoiseSettings, name: str, values: FloatArray) -> None:
        kind = type(getattr(noise, name))
        self._values = values
        self._current = int(np.searchsorted(values, float(getattr(noise, name))))
        self._tried = [noise.model_copy(update={name: kind(value)}) for value in values.tolist()]
        # By the scan's stamp: its labelled samples, and those on which each value agrees.
        self._labelled: dict[int, IntArray] = {}
        self._agreed: dict[int, IntArray] = {}

    def add(self, frame: LabelledFrame, alignment: RecordingAlignment, time: TimeSettings) -> None:
        pairs, stamp_ns = frame.match.correspondence, frame.match.scan.stamp_ns
        sides = ((frame.lidar, pairs.lidar_range_m), (frame.depth, pairs.depth_m))
        # (2 sides, 2: noise and good, B)
        labelled = np.stack(
            [
                np.isfinite(value_m) & [is_rejected(label), _is_real(label)]
                for label, value_m in sides
            ]
        )
        agreed = np.zeros((len(self._tried), 2, 2), dtype=np.int64)
        tried = classify_match(frame.match, alignment, time, self._tried)
        for place, classes in enumerate(tried):
            burr = np.stack([classes.lidar_class, classes.depth_class]) == NoiseClass.BURR
            agreed[place, :, 0] = (labelled[:, 0] & burr).sum(axis=-1)
            agreed[place, :, 1] = (labelled[:, 1] & ~burr).sum(axis=-1)
        counts = labelled.sum(axis=-1)
        self._labelled[stamp_ns] = self._labelled.get(stamp_ns, 0) + counts
        self._agreed[stamp_ns] = self._agreed.get(stamp_ns, 0) + agreed

    def fit(self) -> ThresholdFit | None:
        stamps_ns = sorted(self._labelled)
        if len(stamps_ns) < 2:
            return None
        labelled = np.stack([self._labelled[stamp] for stamp in stamps_ns])
        agreed = np.stack([self._agreed[stamp] for stamp in stamps_ns])
        return fit_threshold(
            ThresholdSweep(
                values=self._values,
                current=self._current,
                noise=labelled[:, :, 0],
                good=labelled[:, :, 1],
                noise_found=agreed[..., 0],
                good_kept=agreed[..., 1],
            )
        )


def _is_real(label: IntArray) -> BoolArray:
    return np.isin(label, (Label.GOOD, Label.CONFLICT))
