"""The options of a SLAM run, and which of them a recording supports."""

from typing import Literal, get_args

from pydantic import BaseModel, ConfigDict, Field

from fusion_core.workflows.fuse.recorded_streams import RecordedStreams
from fusion_core.workflows.map.estimators import SlamKind
from fusion_core.workflows.map.motion_prior import MotionKind
from fusion_core.workflows.map.options import FusionKind, MapSlamKind
from fusion_core.workflows.map.scan_source import ScanKind

SCANS: tuple[ScanKind, ...] = get_args(ScanKind)
MOTIONS: tuple[MotionKind, ...] = get_args(MotionKind)
ESTIMATORS: tuple[MapSlamKind, ...] = (*get_args(SlamKind), "visual")
FUSIONS: tuple[FusionKind, ...] = get_args(FusionKind)
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
    "visual-slam": (("color", "depth"),),
    "fused": (("lidar",), ("color", "depth")),
    "none": ((),),
}
_FUSION_NEEDS: dict[str, _Needs] = {
    "none": ((),),
    "table": (("lidar", "depth"),),
    "bayes": (("lidar", "depth"),),
}
_ESTIMATOR_NEEDS: dict[str, _Needs] = {
    "none": ((),),
    "particle-filter": ((),),
    "pose-graph": ((),),
    "visual": (("color", "depth"),),
}


class SlamChoices(BaseModel):
    """Input scans, motion prior and pose estimator. ``fusion``: how the grids of both sensors are
    fused. ``particles``: for the particle filter only.
    Visual SLAM takes the camera's images, and no scans."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    scan: ScanKind = "lidar"
    motion: MotionKind = "recorded"
    estimator: MapSlamKind = "pose-graph"
    fusion: FusionKind = "none"
    particles: int = Field(30, ge=PARTICLES_MIN, le=PARTICLES_MAX)

    @property
    def is_visual(self) -> bool:
        """Whether poses come from colour and depth images alone."""
        return self.estimator == "visual"

    @property
    def label(self) -> str:
        """A short label, for a list of runs."""
        if self.is_visual:
            return self.estimator
        many = f" ({self.particles})" if self.estimator == "particle-filter" else ""
        fused = "" if self.fusion == "none" else f", fused by {self.fusion}"
        return f"{self.scan}, {self.motion}, {self.estimator}{many}{fused}"


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
    reason = _missing_streams_reason("SLAM", choices.estimator, _ESTIMATOR_NEEDS, held)
    if choices.is_visual:
        return reason
    reason = (
        reason
        or _missing_streams_reason("Scan", choices.scan, _SCAN_NEEDS, held)
        or _missing_streams_reason("Motion", choices.motion, _MOTION_NEEDS, held)
        or _missing_streams_reason("Fusion", choices.fusion, _FUSION_NEEDS, held)
    )
    if reason is None and choices.fusion != "none" and choices.scan == "repaired":
        return (
            "Repaired scans hold the camera's ranges, which would count twice in a fusion: choose "
            "another scan, or no fusion."
        )
    if reason is None and choices.estimator == "none" and choices.motion == "none":
        return "Without SLAM and without motion there are no poses: choose one of the two."
    return reason


def supported_choices(choices: SlamChoices, held: frozenset[Stream]) -> SlamChoices:
    """The choices, with the first possible scan and motion instead of an impossible one; visual
    SLAM where there are colour and depth images and no LiDAR, and not where it is impossible.

    Without any scan, that stays as it is.
    """
    estimator, fusion = choices.estimator, choices.fusion
    if "lidar" not in held and _is_met(_ESTIMATOR_NEEDS["visual"], held):
        estimator = "visual"
    elif not _is_met(_ESTIMATOR_NEEDS[estimator], held):
        estimator = "pose-graph"
    if not _is_met(_FUSION_NEEDS[fusion], held):
        fusion = "none"
    scan, motion = choices.scan, choices.motion
    if not _is_met(_SCAN_NEEDS[scan], held):
        scan = next((name for name in SCANS if _is_met(_SCAN_NEEDS[name], held)), scan)
    if not _is_met(_MOTION_NEEDS[motion], held):
        motion = next(name for name in MOTIONS if _is_met(_MOTION_NEEDS[name], held))
    return choices.model_copy(
        update={"scan": scan, "motion": motion, "estimator": estimator, "fusion": fusion}
    )


def choices_for(choices: SlamChoices, held: frozenset[Stream]) -> SlamChoices:
    """The choices; if nobody has made any and the first ones are impossible with these streams,
    those that are possible."""
    is_first = choices == SlamChoices()
    if not is_first or unsupported_reason(choices, held) is None:
        return choices
    return supported_choices(choices, held)


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
