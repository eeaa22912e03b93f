"""Errors of the repaired samples of one sensor, beside those of its baselines."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fusion_core.model.classes import RepairSource, is_repaired
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only

# By definition of the measure: a fixed part, and one that grows with range as depth noise does.
MOVED_FARTHER_M = 0.05
MOVED_FARTHER_RATIO = 0.02
# By definition of the measure: farther than any noise indoors, so on a surface behind the true one.
BEHIND_SURFACE_M = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairErrors:
    """Absolute errors over the repaired samples of one sensor, and what there was to repair.

    ``wide``: (n,) whether the sample lies in a gap of 3 degrees and more. ``source``: (n,) codes
    of RepairSource. ``error_m``: (n,). ``baseline_error_m``: (n,) for each baseline, NaN where it
    has no value; empty where no baseline could be computed. ``hole``: (n,) holes, the rest are
    burrs. ``behind``: (n,) repaired values more than 0.3 m behind the true surface.
    ``wanted_wide``, ``wanted_narrow``: holes and burrs, repaired or not; ``wanted_holes``: holes.
    ``returns``, ``returns_moved_farther``: true returns, and those whose repaired value is not the
    raw one and lies farther than both raw and true value by more than 5 cm + 2 %.
    The arrays hold a few numbers a frame, far less than the truth itself.
    """

    wide: BoolArray
    hole: BoolArray
    source: IntArray
    error_m: FloatArray
    behind: BoolArray
    baseline_error_m: dict[str, FloatArray]
    wanted_wide: int
    wanted_narrow: int
    wanted_holes: int
    returns: int
    returns_moved_farther: int

    def __post_init__(self) -> None:
        arrays = (self.wide, self.hole, self.source, self.error_m, self.behind)
        for array in (*arrays, *self.baseline_error_m.values()):
            if array.shape != self.wide.shape:
                raise ValueError("all arrays of repair errors must have one length")
            read_only(array)

    @property
    def moved_farther(self) -> int:
        """True returns that were moved farther, and samples filled behind the true surface: both
        call free what is not."""
        return self.returns_moved_farther + int(self.behind.sum())

    @property
    def moved_farther_fraction(self) -> float | None:
        """Samples moved farther / true returns and filled samples."""
        return _fraction(self.moved_farther, self.returns + self.behind.size)

    def to_json(self) -> dict[str, Any]:
        """Median, 90th percentile and RMS by width of the gap, beside those of the baselines."""
        return {
            "wide": self._gap_json(self.wide, self.wanted_wide),
            "narrow": self._gap_json(~self.wide, self.wanted_narrow),
            "by_source": {
                "all": self._source_json(np.ones(self.source.size, dtype=np.bool_)),
                **{
                    source.name.lower(): self._source_json(self.source == source)
                    for source in (RepairSource.OTHER_SENSOR, RepairSource.NEIGHBOURS)
                },
            },
            "holes": self.wanted_holes,
            "holes_filled": _fraction(int(self.hole.sum()), self.wanted_holes),
            "returns": self.returns,
            "returns_moved_farther": _fraction(self.returns_moved_farther, self.returns),
            "moved_farther": self.moved_farther_fraction,
        }

    def _source_json(self, chosen: BoolArray) -> dict[str, Any]:
        behind = _fraction(int(self.behind[chosen].sum()), int(chosen.sum()))
        return {**_summarise_errors(self.error_m[chosen]), "behind_surface": behind}

    def _gap_json(self, chosen: BoolArray, wanted: int) -> dict[str, Any]:
        own = _summarise_errors(self.error_m[chosen])
        entry: dict[str, Any] = {
            "wanted": wanted,
            "repaired": _fraction(int(chosen.sum()), wanted),
            "own": own,
        }
        for baseline, error_m in self.baseline_error_m.items():
            spread = _summarise_errors(error_m[chosen])
            entry[baseline] = spread | {
                f"own_to_{name}": _ratio(own[f"{name}_m"], spread[f"{name}_m"])
                for name in ("median", "p90", "rms")
            }
        return entry


def was_repaired(source: IntArray, repaired_m: FloatArray) -> BoolArray:
    """Whether each sample was filled from the other sensor or from neighbours."""
    repaired: BoolArray = is_repaired(source) & np.isfinite(repaired_m)
    return repaired


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ComparedSamples:
    """Samples of one sensor with their true and repaired values; all arrays are (n,).

    ``wanted``: holes and burrs in truth, ``hole``: the holes among them. ``repaired``: those of
    ``wanted`` with a repair. ``wide``: in a wide gap. ``source``: codes of RepairSource.
    ``true_m``, ``raw_m``, ``repaired_m``: values of the sensor. ``returns``: good in truth with a
    raw value.
    """

    wanted: BoolArray
    hole: BoolArray
    repaired: BoolArray
    wide: BoolArray
    source: IntArray
    true_m: FloatArray
    raw_m: FloatArray
    repaired_m: FloatArray
    returns: BoolArray


def repair_errors(samples: ComparedSamples, baseline_m: dict[str, FloatArray]) -> RepairErrors:
    """Errors over the samples that were repaired. ``baseline_m``: (n,) values of each baseline."""
    true_m, repaired = samples.true_m, samples.repaired
    farthest_m = np.fmax(true_m, samples.raw_m)
    limit_m = farthest_m + MOVED_FARTHER_M + MOVED_FARTHER_RATIO * farthest_m
    is_moved_farther = samples.returns & (samples.repaired_m > limit_m)
    return RepairErrors(
        wide=samples.wide[repaired],
        hole=samples.hole[repaired],
        source=samples.source[repaired],
        error_m=np.abs(samples.repaired_m - true_m)[repaired],
        behind=(samples.repaired_m > true_m + BEHIND_SURFACE_M)[repaired],
        baseline_error_m={
            name: np.abs(value_m - true_m)[repaired] for name, value_m in baseline_m.items()
        },
        wanted_wide=int((samples.wanted & samples.wide).sum()),
        wanted_narrow=int((samples.wanted & ~samples.wide).sum()),
        wanted_holes=int(samples.hole.sum()),
        returns=int(samples.returns.sum()),
        returns_moved_farther=int(is_moved_farther.sum()),
    )


def pool_errors(parts: Sequence[RepairErrors], baselines: Sequence[str]) -> RepairErrors:
    """All parts as one, with the named baselines, which each part must have."""
    return RepairErrors(
        wide=_concatenate([part.wide for part in parts], np.bool_),
        hole=_concatenate([part.hole for part in parts], np.bool_),
        source=_concatenate([part.source for part in parts], np.int64),
        error_m=_concatenate([part.error_m for part in parts], np.float64),
        behind=_concatenate([part.behind for part in parts], np.bool_),
        baseline_error_m={
            name: _concatenate([part.baseline_error_m[name] for part in parts], np.float64)
            for name in baselines
        },
        wanted_wide=sum(part.wanted_wide for part in parts),
        wanted_narrow=sum(part.wanted_narrow for part in parts),
        wanted_holes=sum(part.wanted_holes for part in parts),
        returns=sum(part.returns for part in parts),
        returns_moved_farther=sum(part.returns_moved_farther for part in parts),
    )


def _concatenate(parts: Sequence[Any], dtype: Any) -> Any:
    return np.concatenate([np.empty(0, dtype), *parts])


def _summarise_errors(error_m: FloatArray) -> dict[str, Any]:
    """Count, median, 90th percentile and root mean square; None where there is nothing."""
    known = error_m[np.isfinite(error_m)]
    if known.size == 0:
        return {"count": 0, "median_m": None, "p90_m": None, "rms_m": None}
    return {
        "count": int(known.size),
        "median_m": float(np.median(known)),
        "p90_m": float(np.percentile(known, 90.0)),
        "rms_m": float(np.sqrt(np.mean(known**2))),
    }


def _fraction(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _ratio(own: float | None, baseline: float | None) -> float | None:
    return own / baseline if own is not None and baseline else None
