"""The measures of ``scanloom evaluate``, each one call of a function in its workflow.

The workflow is imported inside the commands, so that ``--help`` is quick.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro import conf

from fusion_core.model.progress import Progress
from scanloom.commands.options import Flag
from scanloom.commands.reports import (
    Report,
    map_lines,
    measure_lines,
    relation_lines,
    trajectory_lines,
)


@dataclass(frozen=True, kw_only=True)
class _Evaluation:
    fuse_dir: Annotated[conf.Positional[Path], conf.arg(metavar="FUSE_DIR")]
    """A folder that fuse has written."""
    truth: Annotated[conf.Positional[Path], conf.arg(metavar="TRUTH.npz")]
    """The truth of the same recording."""
    lever_arm: Annotated[
        tuple[float, float, float] | None,
        conf.arg(metavar="FORWARD LEFT UP", help_behavior_hint=""),
    ] = None
    """The camera's place seen from the LiDAR (m), for a truth that does not know it."""
    pitch: Annotated[float, conf.arg(metavar="RAD")] = 0.0
    """How far the camera looks down, with --lever-arm."""
    clock_offset_ms: Annotated[float | None, conf.arg(metavar="MS", help_behavior_hint="")] = None
    """Camera stamp less LiDAR stamp of one instant, for a truth that does not know it."""
    json: Flag = False
    """Print one JSON object on stdout."""

    def _report(self, measure: Callable[..., dict[str, Any]], **more: Any) -> Report:
        result = measure(
            self.fuse_dir,
            self.truth,
            lever_arm_m=self.lever_arm,
            pitch_rad=self.pitch,
            clock_offset_ms=self.clock_offset_ms,
            **more,
        )
        return Report(result=result, lines=measure_lines(result))


@dataclass(frozen=True, kw_only=True)
class EvaluateAlignment(_Evaluation):
    """Offset of each frame and yaw of the mount against the truth."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.evaluate import evaluate

        return self._report(evaluate.alignment)


@dataclass(frozen=True, kw_only=True)
class EvaluateNoise(_Evaluation):
    """Recall of good pairs and of noise pairs, attribution, and what became of conflicts."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.evaluate import evaluate

        return self._report(evaluate.noise)


@dataclass(frozen=True, kw_only=True)
class EvaluateRepair(_Evaluation):
    """Error of the repaired values against the truth, beside plain interpolation."""

    recording: Annotated[Path | None, conf.arg(metavar="RECORDING", help_behavior_hint="")] = None
    """What was fused, for the rivals that fill whole depth images."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.evaluate import evaluate

        return self._report(evaluate.repair, recording=self.recording)


@dataclass(frozen=True, kw_only=True)
class EvaluateTrajectory:
    """Absolute and relative pose errors of a trajectory against a reference, both TUM files."""

    estimate: Annotated[conf.Positional[Path], conf.arg(metavar="ESTIMATE")]
    """Lines of: stamp x y z qx qy qz qw (s, m)."""
    reference: Annotated[conf.Positional[Path], conf.arg(metavar="REFERENCE")]
    """Lines of the same kind, interpolated at the estimate's stamps."""
    align: Literal["se3", "se2", "sim3", "none"] = "se3"
    """Lay the estimate on the reference: in space, in the plane (height, pitch and roll are then
    dropped), with a scale (for monocular estimates), or not at all."""
    delta: Annotated[float, conf.arg(metavar="STEP")] = 1.0
    """The step of the relative errors, in --unit."""
    unit: Literal["s", "m", "frames"] = "s"
    """Seconds, metres along the reference, or poses of the estimate."""
    greatest_gap: Annotated[float, conf.arg(metavar="S")] = 0.2
    """Compare nothing where the reference has a gap longer than S seconds."""
    json: Flag = False
    """Print one JSON object on stdout."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.evaluate import evaluate

        result = evaluate.trajectory(
            self.estimate,
            self.reference,
            alignment=self.align,
            delta=self.delta,
            unit=self.unit,
            greatest_gap_s=self.greatest_gap,
        )
        return Report(result=result, lines=trajectory_lines(result))


@dataclass(frozen=True, kw_only=True)
class EvaluateRelations:
    """Errors of a trajectory over known relations between its poses (Kümmerle 2009)."""

    trajectory: Annotated[conf.Positional[Path], conf.arg(metavar="TRAJECTORY")]
    """A TUM file, lines of: stamp x y z qx qy qz qw (s, m)."""
    relations: Annotated[conf.Positional[Path], conf.arg(metavar="RELATIONS")]
    """Lines of: t1 t2 x y z roll pitch yaw (s, m, rad)."""
    json: Flag = False
    """Print one JSON object on stdout."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.evaluate import evaluate

        result = evaluate.relations(self.trajectory, self.relations)
        return Report(result=result, lines=relation_lines(result))


@dataclass(frozen=True, kw_only=True)
class EvaluateMap:
    """How much of a world's obstacles a map shows, and how true its lengths and angles are
    (Li 2022, eq. 10 and Table 4)."""

    map: Annotated[conf.Positional[Path], conf.arg(metavar="MAP.yaml")]
    """A map as ROS's map_server has it; the picture stands beside it."""
    world: Annotated[conf.Positional[Path], conf.arg(metavar="WORLD.json")]
    """The outline of the world, written beside a synthetic recording."""
    align: Literal["auto", "none"] = "auto"
    """Lay the map over the world first, or take it to be in the world's frame."""
    pose: Annotated[
        tuple[float, float, float] | None, conf.arg(metavar="X Y YAW", help_behavior_hint="")
    ] = None
    """Where the map's frame lies in the world (m, m, rad): with --align none as it is, else to
    within 1 m and 20 degrees; without it the whole world is searched."""
    json: Flag = False
    """Print one JSON object on stdout."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.evaluate import evaluate

        result = evaluate.ros_map(self.map, self.world, align=self.align == "auto", pose=self.pose)
        return Report(result=result, lines=map_lines(result))


@dataclass(frozen=True, kw_only=True)
class EvaluateOdometry:
    """Errors of each odometry over the way, and over its straight stretches (Li 2022, Table 5)."""

    map_dir: Annotated[conf.Positional[Path], conf.arg(metavar="MAP_DIR")]
    """A folder that map has written: its odometry_*.tum and trajectory.tum."""
    reference: Annotated[conf.Positional[Path], conf.arg(metavar="REFERENCE")]
    """A TUM file, or the truth (.npz) of a synthetic recording."""
    json: Flag = False
    """Print one JSON object on stdout."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.evaluate.odometry import odometry, odometry_lines

        result = odometry(self.map_dir, self.reference)
        return Report(result=result, lines=odometry_lines(result))


@dataclass(frozen=True, kw_only=True)
class Evaluate:
    """Measure a result against the truth, a reference or relations."""

    measure: conf.OmitSubcommandPrefixes[
        Annotated[EvaluateAlignment, conf.subcommand("alignment")]
        | Annotated[EvaluateNoise, conf.subcommand("noise")]
        | Annotated[EvaluateRepair, conf.subcommand("repair")]
        | Annotated[EvaluateTrajectory, conf.subcommand("trajectory")]
        | Annotated[EvaluateRelations, conf.subcommand("relations")]
        | Annotated[EvaluateMap, conf.subcommand("map")]
        | Annotated[EvaluateOdometry, conf.subcommand("odometry")]
    ]
