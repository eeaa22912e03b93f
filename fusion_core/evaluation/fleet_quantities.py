"""What is compared among the recordings of one rig, and from which shift on it matters."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fusion_core.model.conventions import FloatArray, wrap_angle
from fusion_core.settings import StageSettings, setting

FlagKind = Literal["mount moved", "clock drifts", "lens went blind", "sensors disagree"]


class FleetSettings(StageSettings):
    """When a recording is flagged against the others of its rig."""

    false_alarm_rate: float = setting(
        0.05,
        "Probability that a batch of sound recordings has any flag; the threshold of z follows "
        "from it and from the number of comparisons",
        gt=0.0,
        le=0.5,
    )
    z_min: float = setting(
        3.0,
        "No flag below this z, the shift over the root of the fleet's squared spread and the "
        "recording's own variance, even where false_alarm_rate allows it",
        ge=1.0,
        le=100.0,
    )
    recordings_min: int = setting(
        8, "Recordings of a rig in which a quantity must be known to be compared", ge=6, le=10_000
    )
    angle_shift_min_deg: float = setting(
        0.5, "Smallest turn of the mount that matters", unit="deg", gt=0.0, le=90.0
    )
    position_shift_min_m: float = setting(
        0.03, "Smallest displacement of the mount that matters", unit="m", gt=0.0, le=10.0
    )
    clock_shift_min_ms: float = setting(
        20.0, "Smallest shift of the clock that matters", unit="ms", gt=0.0, le=10_000.0
    )
    agreement_drop_min: float = setting(
        0.05, "Smallest drop of the agreement that matters", gt=0.0, le=1.0
    )
    share_factor_min: float = setting(
        2.0, "Smallest factor of a share of holes, burrs or conflicts that matters", gt=1.0, le=1e3
    )
    share_rise_min: float = setting(
        0.05,
        "Smallest rise of a share of holes, burrs or conflicts that matters, besides its factor",
        gt=0.0,
        le=1.0,
    )
    untrusted_rise_min: float = setting(
        0.1, "Smallest rise of the share of frames not trusted that matters", gt=0.0, le=1.0
    )


Scale = Literal["linear", "angle", "proportion"]
Side = Literal["both", "above", "below"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """A value of a recording that is compared with the others of its rig.

    ``name``: as in the rows of a batch, with its unit. ``shift_setting``: the setting that holds
    the smallest shift that matters, in ``setting_unit`` units of the quantity; with ``is_factor``
    a shift must be by ``share_factor_min`` too. ``scale``: an "angle" is compared modulo a turn, a
    "proportion" as the arc sine of its root, on which the chance of counting varies equally
    everywhere. ``side``: where a shift is bad.
    """

    name: str
    label: str
    kind: FlagKind
    shift_setting: str
    setting_unit: float = 1.0
    scale: Scale = "linear"
    side: Side = "both"
    is_factor: bool = False

    def smallest_shift(self, median: FloatArray, settings: FleetSettings) -> FloatArray:
        """The smallest shifts from medians that matter, in the quantity's unit."""
        smallest = float(getattr(settings, self.shift_setting)) * self.setting_unit
        factor = settings.share_factor_min if self.is_factor else 1.0
        return np.maximum(smallest, (factor - 1.0) * median)

    def shift(self, values: FloatArray, median: FloatArray) -> FloatArray:
        """How far values lie from medians, positive to the bad side."""
        apart = wrap_angle(values - median) if self.scale == "angle" else values - median
        return {"both": np.abs(apart), "above": apart, "below": -apart}[self.side]

    def smallest_step(self, scaled: FloatArray, settings: FleetSettings) -> FloatArray:
        """The smallest shifts from medians that matter, medians and shifts on the compared
        scale."""
        median = self.from_scale(scaled)
        shift = self.smallest_shift(median, settings)
        shifted = median + (-shift if self.side == "below" else shift)
        if self.scale == "proportion":
            shifted = np.clip(shifted, 0.0, 1.0)
        return np.abs(self.to_scale(shifted) - scaled)

    def to_scale(self, values: FloatArray) -> FloatArray:
        """Values on the scale on which they are compared."""
        return np.arcsin(np.sqrt(values)) if self.scale == "proportion" else values

    def sd_to_scale(self, values: FloatArray, sd: FloatArray) -> FloatArray:
        """Standard deviations of values on the scale on which they are compared."""
        if self.scale != "proportion":
            return sd
        low, high = np.clip(values - sd, 0.0, 1.0), np.clip(values + sd, 0.0, 1.0)
        return 0.5 * (self.to_scale(high) - self.to_scale(low))

    def from_scale(self, scaled: FloatArray) -> FloatArray:
        """The reverse of ``to_scale``, beyond its ends the value there."""
        if self.scale != "proportion":
            return scaled
        return np.asarray(np.sin(np.clip(scaled, 0.0, 0.5 * np.pi)) ** 2)


def _mount(name: str, label: str) -> Quantity:
    is_angle = name.endswith("_rad")
    return Quantity(
        name=name,
        label=label,
        kind="mount moved",
        shift_setting="angle_shift_min_deg" if is_angle else "position_shift_min_m",
        setting_unit=float(np.deg2rad(1.0)) if is_angle else 1.0,
        scale="angle" if is_angle else "linear",
    )


def _share(name: str, label: str, kind: FlagKind) -> Quantity:
    return Quantity(
        name=name,
        label=label,
        kind=kind,
        shift_setting="share_rise_min",
        scale="proportion",
        side="above",
        is_factor=True,
    )


QUANTITIES: tuple[Quantity, ...] = (
    _mount("yaw_rad", "mount yaw"),
    _mount("pitch_rad", "mount pitch"),
    _mount("delta_z_m", "mount height"),
    _mount("forward_m", "mount forward"),
    _mount("left_m", "mount left"),
    Quantity(
        name="clock_offset_ms",
        label="clock offset",
        kind="clock drifts",
        shift_setting="clock_shift_min_ms",
    ),
    Quantity(
        name="agreement",
        label="agreement",
        kind="lens went blind",
        shift_setting="agreement_drop_min",
        scale="proportion",
        side="below",
    ),
    _share("lidar_hole_share", "LiDAR holes", "lens went blind"),
    _share("depth_hole_share", "depth holes", "lens went blind"),
    _share("lidar_burr_share", "LiDAR burrs", "lens went blind"),
    _share("depth_burr_share", "depth burrs", "lens went blind"),
    _share("lidar_conflict_share", "LiDAR conflicts", "sensors disagree"),
    _share("depth_conflict_share", "depth conflicts", "sensors disagree"),
    Quantity(
        name="untrusted_share",
        label="frames not trusted",
        kind="sensors disagree",
        shift_setting="untrusted_rise_min",
        scale="proportion",
        side="above",
    ),
)
