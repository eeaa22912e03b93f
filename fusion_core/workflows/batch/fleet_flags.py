"""Which recordings of a batch differ from the others of their rig, and the sentences why."""

from dataclasses import dataclass

import numpy as np

from fusion_core.evaluation.fleet import Flag, FleetDeviations, FleetValues, find_deviations
from fusion_core.evaluation.fleet_quantities import QUANTITIES, FleetSettings
from fusion_core.workflows.batch.columns import Row, column_of

_SD_COLUMNS = {quantity.name: f"{quantity.name}_sd" for quantity in QUANTITIES}


@dataclass(frozen=True, slots=True, kw_only=True)
class FlaggedRow:
    """``urgency``: the largest z over its threshold. ``kinds`` without repetition, the most urgent
    first; ``reasons``: a sentence for each quantity."""

    number: int
    urgency: float
    kinds: tuple[str, ...]
    reasons: tuple[str, ...]
    quantities: tuple[str, ...]


class FleetTable:
    """Collects what is compared of each row, without holding the rows."""

    def __init__(self) -> None:
        self._robots: list[str] = []
        self._geometries: list[str] = []
        self._values: list[list[float]] = []
        self._sd: list[list[float]] = []

    def add(self, row: Row) -> None:
        """Add the next row. Of what failed nothing is known."""
        self._robots.append(row["robot"] or "")
        self._geometries.append(row["geometry"] or "")
        self._values.append([_known(row.get(quantity.name)) for quantity in QUANTITIES])
        self._sd.append([_known(row.get(_SD_COLUMNS[q.name])) for q in QUANTITIES])

    def compare(self, settings: FleetSettings) -> FleetDeviations:
        """Compare each recording with the others of its rig. Those without any value are of no
        rig of others."""
        shape = (len(self._robots), len(QUANTITIES))
        return find_deviations(
            FleetValues(
                robot=tuple(self._robots),
                geometry=tuple(self._geometries),
                values=np.array(self._values, dtype=np.float64).reshape(shape),
                sd=np.array(self._sd, dtype=np.float64).reshape(shape),
            ),
            settings,
        )


def flagged_rows(found: FleetDeviations) -> list[FlaggedRow]:
    """The flagged recordings, the most urgent first."""
    flagged = []
    for number in np.flatnonzero(found.is_flagged.any(axis=1)).tolist():
        flags = list(found.flags(number))
        flagged.append(
            FlaggedRow(
                number=number,
                urgency=abs(flags[0].z) / flags[0].threshold,
                kinds=tuple(dict.fromkeys(flag.kind for flag in flags)),
                reasons=tuple(map(reason, flags)),
                quantities=tuple(flag.quantity.name for flag in flags),
            )
        )
    return sorted(flagged, key=lambda row: (-row.urgency, row.number))


def reason(flag: Flag) -> str:
    """Why a quantity is flagged, as a sentence."""
    column = column_of(flag.quantity.name)
    unit = f" {column.shown_unit}".rstrip()
    value, median, low, high = (
        column.format(number) for number in (flag.value, flag.median, flag.low, flag.high)
    )
    return (
        f"{flag.quantity.label} {value}{unit}: the others have {median}{unit}, most of them "
        f"{low} to {high}{unit}; z = {flag.z:.1f}, flagged from {flag.threshold:.1f} on."
    )


def settings_notes(settings: FleetSettings, comparisons: int) -> list[str]:
    """How it was compared, in sentences for people."""
    if comparisons == 0:
        return []
    return [
        f"{comparisons:,} values are compared, each with those of the other recordings of the same "
        "rig: z is its distance from their median over the root of their squared spread (Qn) and "
        "its own variance.",
        f"By chance, one batch in {1.0 / settings.false_alarm_rate:.0f} of sound recordings has "
        "any flag. Shifts that do not matter are not flagged: below "
        f"{settings.angle_shift_min_deg:g}° or {settings.position_shift_min_m * 100:g} cm of the "
        f"mount, {settings.clock_shift_min_ms:g} ms of the clock, "
        f"{settings.agreement_drop_min * 100:g} points of agreement, "
        f"{settings.untrusted_rise_min * 100:g} points of images not trusted, and "
        f"{settings.share_rise_min * 100:g} points or a factor of {settings.share_factor_min:g} of "
        "holes, burrs or conflicts.",
        "What a recording does not show is neither flagged nor counted.",
    ]


def _known(value: object) -> float:
    return float(value) if isinstance(value, int | float) else np.nan
