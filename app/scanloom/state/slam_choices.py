"""What a person asks of a run of SLAM, and what a recording can do of it."""

from typing import Literal, get_args

from pydantic import BaseModel, ConfigDict, Field

from fusion_core.workflows.fuse.session import Session
from fusion_core.workflows.map.estimators import SlamKind
from fusion_core.workflows.map.motion_prior import MotionKind
from fusion_core.workflows.map.scan_source import ScanKind

SCANS: tuple[ScanKind, ...] = get_args(ScanKind)
MOTIONS: tuple[MotionKind, ...] = get_args(MotionKind)
ESTIMATORS: tuple[SlamKind, ...] = get_args(SlamKind)
PARTICLES_MIN, PARTICLES_MAX = 2, 200

Stream = Literal["lidar", "depth", "color", "odometry", "tf"]
_WORDS: dict[Stream, str] = {
    "lidar": "a LaserScan",
    "depth": "depth images",
    "color": "colour images",
    "odometry": "odometry",
    "tf": "TF",
}
# Each tuple is one way to have it, and all its streams are needed.
_Needs = tuple[tuple[Stream, ...], ...]
_SCAN_NEEDS: dict[str, _Needs] = {
    "lidar": (("lidar",),),
    "camera": (("depth",),),
    "repaired": (("lidar", "depth"),),
    "merged": (("lidar", "depth"),),
}
_MOTION_NEEDS: dict[str, _Needs] = {
    "recorded": (("tf",), ("odometry",)),
    "wheel": (("odometry",),),
    "laser": (("lidar",),),
    "visual": (("color", "depth"),),
    "fused": (("lidar",), ("color", "depth")),
    "none": ((),),
}


class SlamChoices(BaseModel):
    """What goes into a run, what is known of the motion beforehand, and what estimates the poses.

    ``particles``: of the particle filter alone.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    scan: ScanKind = "lidar"
    motion: MotionKind = "recorded"
    estimator: SlamKind = "pose-graph"
    particles: int = Field(30, ge=PARTICLES_MIN, le=PARTICLES_MAX)

    @property
    def words(self) -> str:
        """In short, for a list of runs."""
        many = f" ({self.particles})" if self.estimator == "particle-filter" else ""
        return f"{self.scan}, {self.motion}, {self.estimator}{many}"


def streams_of(session: Session) -> frozenset[Stream]:
    """What the recording holds of all that a run may need."""
    streams = session.streams
    held: dict[Stream, bool] = {
        "lidar": streams.lidar is not None,
        "depth": bool(streams.depth),
        "color": any(name is not None for name in streams.color),
        "odometry": streams.odometry is not None,
        "tf": streams.tf is not None,
    }
    return frozenset(name for name, is_held in held.items() if is_held)


def why_not(choices: SlamChoices, held: frozenset[Stream]) -> str | None:
    """Why a recording with these streams cannot do what is chosen, None where it can."""
    said = _lack("Scan", choices.scan, _SCAN_NEEDS, held) or _lack(
        "Motion", choices.motion, _MOTION_NEEDS, held
    )
    if said is None and choices.estimator == "none" and choices.motion == "none":
        return "Without SLAM and without motion there are no poses: choose one of the two."
    return said


def _lack(what: str, name: str, needs: dict[str, _Needs], held: frozenset[Stream]) -> str | None:
    if _is_met(needs[name], held):
        return None
    needed = ", or ".join(" and ".join(_WORDS[one] for one in way) for way in needs[name])
    can = ", ".join(other for other, ways in needs.items() if _is_met(ways, held))
    return (
        f"{what} “{name}” needs {needed}, which this recording lacks. "
        f"It can do: {can or 'nothing'}."
    )


def _is_met(ways: _Needs, held: frozenset[Stream]) -> bool:
    return any(held.issuperset(way) for way in ways)
