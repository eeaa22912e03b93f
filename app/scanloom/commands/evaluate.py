"""``scanloom evaluate``: results against ground truth, a reference trajectory or relations."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro import conf

from fusion_core.model.progress import Progress
from scanloom.commands.label_layer import LabelStoreOption
from scanloom.commands.options import Flag, JsonFlag, RecordingArgument, SettingsOption
from scanloom.commands.reports import (
    Report,
    map_lines,
    measure_lines,
    relation_lines,
    room_lines,
    trajectory_lines,
)


@dataclass(frozen=True, kw_only=True)
class _Evaluation:
    fuse_dir: Annotated[conf.Positional[Path], conf.arg(metavar="FUSE_DIR")]
    """An output folder of fuse."""
    truth: Annotated[conf.Positional[Path], conf.arg(metavar="TRUTH.npz")]
    """The ground truth of the same recording."""
    lever_arm: Annotated[
        tuple[float, float, float] | None,
        conf.arg(metavar="FORWARD LEFT UP", help_behavior_hint=""),
    ] = None
    """The camera's position in the LiDAR frame (m), if the truth file lacks it."""
    pitch: Annotated[float, conf.arg(metavar="RAD")] = 0.0
    """The camera's pitch, positive downwards; used with --lever-arm."""
    clock_offset_ms: Annotated[float | None, conf.arg(metavar="MS", help_behavior_hint="")] = None
    """Camera stamp minus LiDAR stamp of the same instant, if the truth file lacks it."""
    json: JsonFlag = False

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
    """Compare each frame's offset and the mount's yaw with the ground truth."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.evaluate import evaluate

        return self._report(evaluate.alignment)


@dataclass(frozen=True, kw_only=True)
class EvaluateNoise(_Evaluation):
    """Recall of good pairs and of noise pairs, attribution, and the fate of conflicts."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.evaluate import evaluate

        return self._report(evaluate.noise)


@dataclass(frozen=True, kw_only=True)
class EvaluateLabels:
    """Precision and recall of the automatic classes against the labels of a person."""

    recording: RecordingArgument
    """A recording with labels."""
    labels: Annotated[str, conf.arg(metavar="LAYER")]
    """The layer of labels."""
    label_store: LabelStoreOption = None
    preset: Literal["default", "published"] = "default"
    """The project's own settings, or those of Xu 2024."""
    settings: SettingsOption = None
    """A TOML file whose values override the preset's."""
    suggest: Flag = False
    """Fit epsilon and the other thresholds on half of the labels, and try them on the rest."""
    json: JsonFlag = False

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.fuse.session import FuseOptions
        from fusion_core.workflows.labels.evaluate_layer import evaluate_layer
        from fusion_core.workflows.labels.open_store import open_labels

        options = FuseOptions(preset=self.preset, settings_file=self.settings)
        with open_labels(
            self.recording, self.label_store, create=False, progress=progress
        ) as store:
            layer = store.layer(self.labels)
            result = evaluate_layer(
                self.recording, layer, options, suggest=self.suggest, progress=progress
            )
        return Report(result=result, lines=measure_lines(result))


@dataclass(frozen=True, kw_only=True)
class EvaluateRepair(_Evaluation):
    """Error of the repaired values, compared with plain interpolation."""

    recording: Annotated[Path | None, conf.arg(metavar="RECORDING", help_behavior_hint="")] = None
    """The fused recording, for the baselines that fill whole depth images."""

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
    """Align the estimate to the reference: in SE(3), in SE(2) (height, pitch and roll are then
    dropped), in Sim(3) (for monocular estimates), or not at all."""
    delta: Annotated[float, conf.arg(metavar="STEP")] = 1.0
    """The step of the relative errors, in --unit."""
    unit: Literal["s", "m", "frames"] = "s"
    """Unit of --delta: seconds, metres along the reference, or poses of the estimate."""
    greatest_gap: Annotated[float, conf.arg(metavar="S")] = 0.2
    """Skip poses where the reference has a gap longer than S seconds."""
    json: JsonFlag = False

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.evaluate import evaluate

        result = evaluate.trajectory(
            self.estimate,
            self.reference,
            alignment=self.align,
            delta=self.delta,
            unit=self.unit,
            max_gap_s=self.greatest_gap,
        )
        return Report(result=result, lines=trajectory_lines(result))


@dataclass(frozen=True, kw_only=True)
class EvaluateRelations:
    """Errors of a trajectory over known relations between its poses (Kümmerle 2009)."""

    trajectory: Annotated[conf.Positional[Path], conf.arg(metavar="TRAJECTORY")]
    """A TUM file, lines of: stamp x y z qx qy qz qw (s, m)."""
    relations: Annotated[conf.Positional[Path], conf.arg(metavar="RELATIONS")]
    """Lines of: t1 t2 x y z roll pitch yaw (s, m, rad)."""
    json: JsonFlag = False

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.evaluate import evaluate

        result = evaluate.relations(self.trajectory, self.relations)
        return Report(result=result, lines=relation_lines(result))


@dataclass(frozen=True, kw_only=True)
class EvaluateMap:
    """Obstacle detection rate of a map (over all outline as in Li 2022, eq. 10, and over what the
    sensors could see), false obstacles, and errors of lengths and angles (Table 4); or, against a
    ground truth, its false free and false occupied cells."""

    map: Annotated[conf.Positional[Path], conf.arg(metavar="MAP.yaml")]
    """A map in the format of ROS's map_server; the image lies beside it."""
    world: Annotated[conf.Positional[Path], conf.arg(metavar="WORLD.json|TRUTH.npz")]
    """The outline of the world, written beside a synthetic recording; or its ground truth, for a
    map in an output folder of fuse."""
    align: Literal["auto", "none"] = "auto"
    """Align the map to the outlines first, or assume that it is in the world's frame. To a ground
    truth it is never aligned."""
    pose: Annotated[
        tuple[float, float, float] | None, conf.arg(metavar="X Y YAW", help_behavior_hint="")
    ] = None
    """Pose of the map's frame in the world (m, m, rad): exact with --align none, else an initial
    guess to within 1 m and 20 degrees; without it the whole world is searched."""
    json: JsonFlag = False

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.evaluate import evaluate

        if self.world.suffix == ".npz":
            cells = evaluate.map_cells(self.map, self.world, pose=self.pose)
            return Report(result=cells, lines=measure_lines(cells))
        result = evaluate.ros_map(self.map, self.world, align=self.align == "auto", pose=self.pose)
        return Report(result=result, lines=map_lines(result))


@dataclass(frozen=True, kw_only=True)
class EvaluateOdometry:
    """Errors of each odometry over the path and its straight segments (Li 2022, Table 5), below the
    simulated errors that were put in, where the reference states them."""

    map_dir: Annotated[conf.Positional[Path], conf.arg(metavar="MAP_DIR")]
    """An output folder of map, with its odometry_*.tum and trajectory.tum."""
    reference: Annotated[conf.Positional[Path], conf.arg(metavar="REFERENCE")]
    """A TUM file, or the ground truth (.npz) of a synthetic recording."""
    json: JsonFlag = False

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.evaluate.odometry import odometry, odometry_lines

        result = odometry(self.map_dir, self.reference)
        return Report(result=result, lines=odometry_lines(result))


@dataclass(frozen=True, kw_only=True)
class EvaluateRoom:
    """Length, width and height of a box-shaped room from a cloud of it (Song 2022, Table 3)."""

    cloud: Annotated[conf.Positional[Path], conf.arg(metavar="CLOUD")]
    """A PCD, PLY or KITTI .bin file that shows six walls, in metres. Height is what is nearest to
    its z."""
    true: Annotated[
        tuple[float, float, float] | None,
        conf.arg(metavar="LENGTH WIDTH HEIGHT", help_behavior_hint=""),
    ] = None
    """The dimensions as measured otherwise (m), for the errors."""
    settings: SettingsOption = None
    """A TOML file with a table [room]: what counts as a wall."""
    json: JsonFlag = False

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.evaluate import evaluate

        result = evaluate.room(self.cloud, self.true, self.settings)
        return Report(result=result, lines=room_lines(result))


@dataclass(frozen=True, kw_only=True)
class Evaluate:
    """Compare a result with ground truth, a reference trajectory or relations."""

    measure: conf.OmitSubcommandPrefixes[
        Annotated[EvaluateAlignment, conf.subcommand("alignment")]
        | Annotated[EvaluateNoise, conf.subcommand("noise")]
        | Annotated[EvaluateLabels, conf.subcommand("labels")]
        | Annotated[EvaluateRepair, conf.subcommand("repair")]
        | Annotated[EvaluateTrajectory, conf.subcommand("trajectory")]
        | Annotated[EvaluateRelations, conf.subcommand("relations")]
        | Annotated[EvaluateMap, conf.subcommand("map")]
        | Annotated[EvaluateOdometry, conf.subcommand("odometry")]
        | Annotated[EvaluateRoom, conf.subcommand("room")]
    ]
