"""Faults injected into a recording. They do not change the ground truth."""

from fusion_core.model.conventions import FloatArray
from fusion_core.settings import StageSettings, setting
from fusion_core.simulation.paths import WeavingPath
from fusion_core.simulation.random_streams import RandomStream, make_generator


class FaultSettings(StageSettings):
    """Faults to inject; times count from the start of the recording. None by default."""

    scan_loss_fraction: float = setting(
        0.0,
        "Fraction of the scans lost at random",
        ge=0.0,
        le=1.0,
        formerly="scan_loss_share",
    )
    silence_at_s: float = setting(
        0.0,
        "Start of a dropout of all sensors",
        unit="s",
        ge=0.0,
        le=3_600.0,
    )
    silence_s: float = setting(0.0, "Length of the dropout", unit="s", ge=0.0, le=3_600.0)
    slip_at_s: float = setting(0.0, "Start of wheel slip", unit="s", ge=0.0, le=3_600.0)
    slip_s: float = setting(0.0, "Length of the slip", unit="s", ge=0.0, le=3_600.0)
    slip_factor: float = setting(
        2.0, "Reported over true distance while the wheels slip", ge=0.0, le=100.0
    )
    dark_at_s: float = setting(
        0.0,
        "Start of a blackout of the cameras: black images without depth",
        unit="s",
        ge=0.0,
        le=3_600.0,
    )
    dark_s: float = setting(0.0, "Length of the blackout", unit="s", ge=0.0, le=3_600.0)
    kidnap_at_s: float | None = setting(
        None,
        "When the robot is kidnapped: moved without its odometry noticing",
        unit="s",
        ge=0.0,
        le=3_600.0,
    )
    kidnap_ahead_m: float = setting(
        3.0,
        "How far along its route a kidnapped robot is moved",
        unit="m",
        ge=0.0,
        le=1_000.0,
    )

    @property
    def has_any(self) -> bool:
        """Whether there is any fault."""
        lengths_s = (self.silence_s, self.slip_s, self.dark_s)
        return self.scan_loss_fraction > 0.0 or max(lengths_s) > 0.0 or self.kidnap_at_s is not None

    def is_dropout(self, time_s: float) -> bool:
        """Whether all sensors are silent at an instant; the end is excluded."""
        return _is_within(time_s, self.silence_at_s, self.silence_s)

    def is_dark(self, time_s: float) -> bool:
        """Whether the cameras are blacked out at an instant."""
        return _is_within(time_s, self.dark_at_s, self.dark_s)

    def slip_factor_at(self, time_s: float) -> float:
        """Ratio of reported to true distance at an instant."""
        return self.slip_factor if _is_within(time_s, self.slip_at_s, self.slip_s) else 1.0

    def is_scan_lost(self, seed: int, index: int) -> bool:
        """Whether the ``index``-th scan of the recording with that seed is lost."""
        if self.scan_loss_fraction == 0.0:
            return False
        draw = make_generator(seed, RandomStream.FAULTS, index).random()
        return bool(draw < self.scan_loss_fraction)


class KidnappedPath:
    """A path that jumps ahead along its route at one instant."""

    def __init__(self, path: WeavingPath, *, at_s: float, ahead_m: float) -> None:
        self._path = path
        self.at_s = at_s
        self._ahead_s = ahead_m / path.speed_m_s

    def pose(self, time_s: float) -> FloatArray:
        """(x, y, yaw) of the robot's base in the world; at ``at_s`` it has already jumped."""
        return self._path.pose(time_s + (self._ahead_s if time_s >= self.at_s else 0.0))

    def poses_around_kidnap(self) -> tuple[FloatArray, FloatArray]:
        """The poses (x, y, yaw) right before and right after the jump."""
        return self._path.pose(self.at_s), self.pose(self.at_s)


def _is_within(time_s: float, start_s: float, length_s: float) -> bool:
    return start_s <= time_s < start_s + length_s
