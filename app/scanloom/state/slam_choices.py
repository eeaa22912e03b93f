"""The options of a SLAM run, and which of them a recording supports."""

from typing import Literal, get_args

from pydantic import BaseModel, ConfigDict, Field

from fusion_core.workflows.fuse.recorded_streams import RecordedStreams
from fusion_core.workflows.map.estimators import SlamKind
from fusion_core.workflows.map.motion_prior import MotionKind
from fusion_core.workflows.map.scan_source import ScanKind

SCANS: tuple[ScanKind, ...] = get_args(ScanKind)
MOTIONS: tuple[MotionKind, ...] = get_args(MotionKind)
ESTIMATORS: tuple[SlamKind, ...] = get_args(SlamKind)
PARTICLES_MIN, PARTICLES_MAX = 2, 200

Stream = Literal["lidar", "depth", "color", "odometry", "tf"]
_STREAM_LABELS: dict[Stream, str] = {
    "lidar": "a LaserScan",
    "depth": "depth images",
    "color": "colour images",
    "odometry": "odometry",
    "tf": "TF",
}
# Alternatives; each needs all of its streams.
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
    """Input scans, motion prior and pose estimator. ``particles``: for the particle filter only."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    scan: ScanKind = "lidar"
    motion: MotionKind = "recorded"
    estimator: SlamKind = "pose-graph"
    particles: int = Field(30, ge=PARTICLES_MIN, le=PARTICLES_MAX)

    @property
    def label(self) -> str:
        """A short label, for a list of runs."""
        many = f" ({self.particles})" if self.estimator == "particle-filter" else ""
        return f"{self.scan}, {self.motion}, {self.estimator}{many}"


def streams_of(opened: RecordedStreams) -> frozenset[Stream]:
    """Which of the streams that runs may need are in the recording."""
    streams = opened.streams
    held: dict[Stream, bool] = {
        "lidar": streams.lidar is not None,
        "depth": bool(streams.depth),
        "color": any(name is not None for name in streams.color),
        "odometry": streams.odometry is not None,
        "tf": streams.tf is not None,
    }
    return frozenset(name for name, is_held in held.items() if is_held)


def unsupported_reason(choices: SlamChoices, held: frozenset[Stream]) -> str | None:
    """Why the choices are impossible with these streams, None if they are possible."""
    reason = _missing_streams_reason(
        "Scan", choices.scan, _SCAN_NEEDS, held
    ) or _missing_streams_reason("Motion", choices.motion, _MOTION_NEEDS, held)
    if reason is None and choices.estimator == "none" and choices.motion == "none":
        return "Without SLAM and without motion there are no poses: choose one of the two."
    return reason


def supported_choices(choices: SlamChoices, held: frozenset[Stream]) -> SlamChoices:
    """The choices, with the first possible scan and motion instead of an impossible one.

    Without any scan they stay as they are.
    """
    scan, motion = choices.scan, choices.motion
    if not _is_met(_SCAN_NEEDS[scan], held):
        scan = next((name for name in SCANS if _is_met(_SCAN_NEEDS[name], held)), scan)
    if not _is_met(_MOTION_NEEDS[motion], held):
        motion = next(name for name in MOTIONS if _is_met(_MOTION_NEEDS[name], held))
    return choices.model_copy(update={"scan": scan, "motion": motion})


def _missing_streams_reason(
    what: str, name: str, needs: dict[str, _Needs], held: frozenset[Stream]
) -> str | None:
    if _is_met(needs[name], held):
        return None
    needed = ", or ".join(
        " and ".join(_STREAM_LABELS[one] for one in option) for option in needs[name]
    )
    can = ", ".join(other for other, options in needs.items() if _is_met(options, held))
    return (
        f"{what} “{name}” needs {needed}, which this recording lacks. Possible: {can or 'nothing'}."
    )


def _is_met(options: _Needs, held: frozenset[Stream]) -> bool:
    return any(held.issuperset(streams) for streams in options)
