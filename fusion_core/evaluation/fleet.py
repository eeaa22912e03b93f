"""Recordings that differ from the others of their rig by more than chance explains.

Each is compared with the rest: z = (x - median) / sqrt(spread^2 + sd^2), median and robust spread
of the other recordings, sd the recording's own standard deviation. The threshold comes from the
wanted rate of false alarms of the whole batch (Sidak's correction on Student's t).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from fusion_core.evaluation.fleet_quantities import QUANTITIES, FlagKind, FleetSettings, Quantity
from fusion_core.evaluation.fleet_spread import qn_scale, z_threshold
from fusion_core.model.conventions import (
    BoolArray,
    FloatArray,
    IntArray,
    read_only,
    wrap_angle,
)

# Of more recordings one does not move the median and the spread of the others: they have one each.
_LEAVE_ONE_OUT_MAX = 200
# The fleet's spread is not taken as less than this part of the smallest shift that matters: equal
# values have none, and z would be infinite.
_SPREAD_MIN_OF_SHIFT = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FleetValues:
    """The quantities of N recordings.

    ``robot``: whose each is, "" where unknown. ``geometry``: of its sensors: recordings of equal
    text can be compared. ``values`` and ``sd``: (N, Q) in the order of QUANTITIES, NaN where a
    value is not known or not observable; ``sd`` NaN where no deviation is known.
    """

    robot: tuple[str, ...]
    geometry: tuple[str, ...]
    values: FloatArray
    sd: FloatArray

    def __post_init__(self) -> None:
        shape = (len(self.robot), len(QUANTITIES))
        if self.values.shape != shape or self.sd.shape != shape:
            raise ValueError(f"values and sd must be {shape}")
        if len(self.geometry) != len(self.robot):
            raise ValueError("robot and geometry must be of the same recordings")
        read_only(self.values)
        read_only(self.sd)


@dataclass(frozen=True, slots=True, kw_only=True)
class Flag:
    """A quantity of a recording that differs. ``median``: of the other recordings of the rig;
    ``low`` and ``high``: one spread below and above it."""

    recording: int
    quantity: Quantity
    value: float
    median: float
    low: float
    high: float
    z: float
    threshold: float

    @property
    def kind(self) -> FlagKind:
        return self.quantity.kind


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FleetDeviations:
    """How far each recording lies from the others of its rig.

    ``rig``: (N,) number of the rig that a recording is compared within, its label in
    ``rig_labels``. ``values``, ``median``, ``spread``, ``z``, ``threshold``: (N, Q), NaN where
    nothing is compared; ``spread`` is of the compared scale. ``is_flagged``: (N, Q). ``notes``:
    what was not compared, and why.
    """

    rig: IntArray
    rig_labels: tuple[str, ...]
    values: FloatArray
    median: FloatArray
    spread: FloatArray
    z: FloatArray
    threshold: FloatArray
    is_flagged: BoolArray
    notes: tuple[str, ...]

    def flags(self, recording: int) -> Iterator[Flag]:
        """The flags of a recording, the largest z over its threshold first."""
        columns = np.flatnonzero(self.is_flagged[recording])
        ratio = np.abs(self.z[recording]) / self.threshold[recording]
        for column in sorted(columns, key=lambda column: -ratio[column]):
            at, quantity = (recording, int(column)), QUANTITIES[column]
            middle = quantity.to_scale(self.median[at])
            yield Flag(
                recording=recording,
                quantity=quantity,
                value=float(self.values[at]),
                median=float(self.median[at]),
                low=float(quantity.from_scale(middle - self.spread[at])),
                high=float(quantity.from_scale(middle + self.spread[at])),
                z=float(self.z[at]),
                threshold=float(self.threshold[at]),
            )


def find_deviations(fleet: FleetValues, settings: FleetSettings) -> FleetDeviations:
    """Compare each recording with the others of its rig."""
    rig, labels = _rigs(fleet, settings)
    shape = fleet.values.shape
    median, spread, z, others = (np.full(shape, np.nan) for _ in range(4))
    notes: list[str] = []
    for number, label in enumerate(labels):
        members = np.flatnonzero(rig == number)
        unknown = []
        for column, quantity in enumerate(QUANTITIES):
            known = members[np.isfinite(fleet.values[members, column])]
            if known.size < settings.recordings_min:
                unknown.append(f"{quantity.label} in {known.size}")
                continue
            at = known, np.full(known.size, column)
            median[at], spread[at], z[at] = _compare(
                fleet.values[at], np.nan_to_num(fleet.sd[at]), quantity, settings
            )
            others[at] = known.size - 1
        if np.isfinite(fleet.values[members]).any():
            notes += _notes(label, members.size, unknown, settings)
    threshold = _thresholds(others, settings)
    with np.errstate(invalid="ignore"):
        is_flagged = (np.abs(z) > threshold) & _is_bad(fleet.values, median, settings)
    return FleetDeviations(
        rig=rig,
        rig_labels=tuple(labels),
        values=fleet.values,
        median=median,
        spread=spread,
        z=z,
        threshold=threshold,
        is_flagged=is_flagged,
        notes=tuple(notes),
    )


def _rigs(fleet: FleetValues, settings: FleetSettings) -> tuple[IntArray, list[str]]:
    """Recordings of one robot with one geometry are of one rig. Those of robots with too few, or
    of none, are put together by their geometry."""
    keys = list(zip(fleet.robot, fleet.geometry, strict=True))
    counts: dict[tuple[str, str], int] = {}
    for key in keys:
        counts[key] = counts.get(key, 0) + 1
    keys = [
        (robot if counts[robot, geometry] >= settings.recordings_min else "", geometry)
        for robot, geometry in keys
    ]
    distinct = sorted(set(keys))
    number = {key: place for place, key in enumerate(distinct)}
    labels = [robot or (geometry or "unknown sensors") for robot, geometry in distinct]
    return np.array([number[key] for key in keys], dtype=np.int64), labels


def _compare(
    values: FloatArray, sd: FloatArray, quantity: Quantity, settings: FleetSettings
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Median, spread and z of (n,) values, each against the others."""
    origin = 0.0
    if quantity.scale == "angle":
        # Sorted, so that the sum does not depend on the order of the recordings.
        origin = float(np.angle(np.exp(1j * np.sort(values)).sum()))
        values = wrap_angle(values - origin)
    scaled = quantity.to_scale(values)
    order = np.argsort(scaled, kind="stable")
    ordered = scaled[order]
    median, spread = np.empty(values.size), np.empty(values.size)
    if values.size > _LEAVE_ONE_OUT_MAX:
        median[:], spread[:] = np.median(ordered), qn_scale(ordered)
    else:
        for place, index in enumerate(order):
            rest = np.delete(ordered, place)
            median[index], spread[index] = np.median(rest), qn_scale(rest)
    spread = np.maximum(spread, _SPREAD_MIN_OF_SHIFT * quantity.smallest_step(median, settings))
    z = (scaled - median) / np.hypot(spread, quantity.sd_to_scale(values, sd))
    centre = quantity.from_scale(median)
    return wrap_angle(centre + origin) if quantity.scale == "angle" else centre, spread, z


def _thresholds(others: FloatArray, settings: FleetSettings) -> FloatArray:
    """(N, Q) thresholds of z, so that any of all comparisons fails by chance at the wanted rate."""
    comparisons = int(np.isfinite(others).sum())
    threshold = np.full(others.shape, np.nan)
    if comparisons == 0:
        return threshold
    probability = -np.expm1(np.log1p(-settings.false_alarm_rate) / comparisons)
    for column, quantity in enumerate(QUANTITIES):
        for count in np.unique(others[np.isfinite(others[:, column]), column]):
            z = z_threshold(probability, int(count), two_sided=quantity.side == "both")
            threshold[others[:, column] == count, column] = max(z, settings.z_min)
    return threshold


def _is_bad(values: FloatArray, median: FloatArray, settings: FleetSettings) -> BoolArray:
    """(N, Q) whether a shift is large enough to matter, and to the bad side."""
    is_bad = np.zeros(values.shape, dtype=np.bool_)
    for column, quantity in enumerate(QUANTITIES):
        shift = quantity.shift(values[:, column], median[:, column])
        is_bad[:, column] = shift >= quantity.smallest_shift(median[:, column], settings)
    return is_bad


def _notes(
    label: str, recordings: int, unknown: Sequence[str], settings: FleetSettings
) -> Iterator[str]:
    least = settings.recordings_min
    if len(unknown) == len(QUANTITIES):
        yield f"{label}: {recordings} recordings, nothing is compared in fewer than {least}."
    elif unknown:
        known = ", ".join(unknown)
        yield f"{label}: not compared, since known in fewer than {least} recordings: {known}."
