"""What may go wrong with a recording on purpose, and when. The truth stays the truth."""

from fusion_core.model.conventions import FloatArray
from fusion_core.settings import StageSettings, setting
from fusion_core.simulation.paths import WeavingPath
from fusion_core.simulation.randomness import Stream, generator


class FaultSettings(StageSettings):
    """The faults of a recording; times count from its start. By default there are none."""

    scan_loss_share: float = setting(0.0, "Share of the scans lost, at random", ge=0.0, le=1.0)
    silence_at_s: float = setting(
        0.0, "No sensor says anything from here", unit="s", ge=0.0, le=3_600.0
    )
    silence_s: float = setting(0.0, "Length of the silence", unit="s", ge=0.0, le=3_600.0)
    slip_at_s: float = setting(0.0, "The wheels slip from here", unit="s", ge=0.0, le=3_600.0)
    slip_s: float = setting(0.0, "Length of the slip", unit="s", ge=0.0, le=3_600.0)
    slip_factor: float = setting(
        2.0, "Distance that the wheels report over the true one while they slip", ge=0.0, le=100.0
    )
    dark_at_s: float = setting(
        0.0, "The cameras see nothing from here: black, and no depth", unit="s", ge=0.0, le=3_600.0
    )
    dark_s: float = setting(0.0, "Length of the darkness", unit="s", ge=0.0, le=3_600.0)
    kidnap_at_s: float | None = setting(
        None,
        "The robot is carried elsewhere, of which its odometry knows nothing",
        unit="s",
        ge=0.0,
        le=3_600.0,
    )
    kidnap_ahead_m: float = setting(
        3.0,
        "How far it is carried along its route, where there is room for it",
        unit="m",
        ge=0.0,
        le=1_000.0,
    )

    @property
    def any(self) -> bool:
        """Whether anything goes wrong at all."""
        lengths_s = (self.silence_s, self.slip_s, self.dark_s)
        return self.scan_loss_share > 0.0 or max(lengths_s) > 0.0 or self.kidnap_at_s is not None

    def silent(self, time_s: float) -> bool:
        """Whether nothing is heard at an instant; the end is not part of the silence."""
        return _within(time_s, self.silence_at_s, self.silence_s)

    def dark(self, time_s: float) -> bool:
        """Whether the cameras see nothing at an instant."""
        return _within(time_s, self.dark_at_s, self.dark_s)

    def slip(self, time_s: float) -> float:
        """Reported over true distance at an instant."""
        return self.slip_factor if _within(time_s, self.slip_at_s, self.slip_s) else 1.0

    def scan_lost(self, seed: int, index: int) -> bool:
        """Whether the ``index``-th scan of the recording with that seed is lost."""
        if self.scan_loss_share == 0.0:
            return False
        draw = generator(seed, Stream.FAULTS, index).random()
        return bool(draw < self.scan_loss_share)


class KidnappedPath:
    """A path that goes on farther along its route from one instant on."""

    def __init__(self, path: WeavingPath, *, at_s: float, ahead_m: float) -> None:
        self._path = path
        self.at_s = at_s
        self._ahead_s = ahead_m / path.speed_m_s

    def pose(self, time_s: float) -> FloatArray:
        """(x, y, yaw) of the robot's base in the world; at the instant itself it is elsewhere."""
        return self._path.pose(time_s + (self._ahead_s if time_s >= self.at_s else 0.0))

    def lifted(self) -> tuple[FloatArray, FloatArray]:
        """Poses from which, and to which, the robot is carried."""
        return self._path.pose(self.at_s), self.pose(self.at_s)


def _within(time_s: float, start_s: float, length_s: float) -> bool:
    return start_s <= time_s < start_s + length_s
