"""A recording of a LiDAR on a turning axis: its clouds, and the axis' angle for each point."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fusion_core.calibration.turning.axis_angles import AxisAngles, make_axis_angles
from fusion_core.calibration.turning.rotating_frame import RotatingFrame, find_rotation_axis
from fusion_core.model.conventions import NS_PER_S, BoolArray, Float32Array, FloatArray
from fusion_core.model.errors import CalibrationFailed, FramesNotConnected, MissingStream
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import JointSample, PointCloud, TransformBatch
from fusion_core.recordings.topics import unknown_topic_error
from fusion_core.workflows.recorded_transforms import RecordedTransforms, frame_name


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanOnAxis:
    """A cloud of a turn. ``xyz_m``: (N, 3) finite, in the LiDAR's frame. ``intensity``: (N,) or
    None. ``axis_angles_rad``: (N,) finite."""

    xyz_m: Float32Array
    intensity: Float32Array | None
    axis_angles_rad: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedAxis:
    """``source``: where the angles come from, for people. ``T_axis_lidar``: (4, 4) the recorded
    mounting, None where the recording has none."""

    angles: AxisAngles
    T_axis_lidar: FloatArray | None
    source: str


@dataclass(slots=True)
class _Counts:
    points: int = 0
    missing: int = 0
    without_angle: int = 0
    without_instant: int = 0
    scans: int = 0


class TurnRecording:
    """Reads the clouds of one topic with the angles of one axis.

    ``points`` and ``joint`` name them where there are several. ``spread_points``: whether the
    points of a cloud without instants count as measured one after another, until the next cloud,
    instead of all at its stamp.

    Raises MissingStream where the recording has no clouds, or nothing that tells the angle;
    CalibrationFailed where that tells of no turn.
    """

    def __init__(self, recording: Recording, points: str | None, joint: str | None) -> None:
        self._recording = recording
        self.notes: list[str] = []
        self._counts = _Counts()
        self.spread_points = False
        self.topic = self._choose_points(points)
        self.frame = self._first_frame()
        stamps_ns = np.sort(recording.stamps_ns(self.topic))
        self._interval_ns = float(np.median(np.diff(stamps_ns))) if stamps_ns.size > 1 else 0.0
        self.axis = self._find_axis(joint)

    @property
    def count(self) -> int:
        """Messages of the topic."""
        return next(t.count for t in self._recording.topics if t.name == self.topic)

    @property
    def lacks_instants(self) -> bool:
        """Whether clouds of the last pass had points without instants of their own."""
        return self._counts.without_instant > 0

    def scans(self) -> Iterator[ScanOnAxis]:
        """Each cloud, without points that have no position or no angle."""
        self._counts = _Counts()
        for message in self._recording.messages([self.topic]):
            cloud = message.value
            if isinstance(cloud, PointCloud):
                yield self._on_axis(cloud)

    def reading_notes(self) -> list[str]:
        """What was left out in the last pass over the clouds."""
        counts = self._counts
        notes = []
        if counts.missing:
            notes.append(f"{counts.missing} of {counts.points} points have no finite position")
        if counts.without_angle:
            notes.append(
                f"{counts.without_angle} of {counts.points} points were measured where the axis "
                "has no samples"
            )
        if counts.without_instant:
            how = "one after another until the next cloud" if self.spread_points else "at the stamp"
            notes.append(
                f"the points of {counts.without_instant} of {counts.scans} clouds have no instants "
                f"of their own: they count as measured {how}, which fits planes better"
            )
        return notes

    def _on_axis(self, cloud: PointCloud) -> ScanOnAxis:
        stamps_ns = np.full(len(cloud.xyz_m), cloud.stamp_ns)
        finite: BoolArray = np.asarray(np.isfinite(cloud.xyz_m).all(axis=1))
        offsets_s = cloud.offsets_s
        self._counts.scans += 1
        if offsets_s is None:
            self._counts.without_instant += 1
            if self.spread_points:
                order = np.arange(len(stamps_ns)) / max(len(stamps_ns), 1)
                stamps_ns += np.rint(self._interval_ns * order).astype(np.int64)
        else:
            np.logical_and(finite, np.isfinite(offsets_s), out=finite)
            stamps_ns[finite] += np.rint(offsets_s[finite] * NS_PER_S).astype(np.int64)
        angles_rad = self.axis.angles.at(stamps_ns)
        known = finite & np.isfinite(angles_rad)
        self._counts.points += len(finite)
        self._counts.missing += int((~finite).sum())
        self._counts.without_angle += int((finite & ~known).sum())
        return ScanOnAxis(
            xyz_m=cloud.xyz_m[known],
            intensity=None if cloud.intensity is None else cloud.intensity[known],
            axis_angles_rad=angles_rad[known],
        )

    def _choose_points(self, named: str | None) -> str:
        topics = [t for t in self._recording.topics if t.role == "points" and t.count > 0]
        if named is not None:
            if named not in {t.name for t in self._recording.topics}:
                raise unknown_topic_error(named, self._recording.topics, self._recording.path)
            if named not in {t.name for t in topics}:
                raise MissingStream(
                    f"{named} holds no clouds.",
                    file=self._recording.path,
                    advice="Name a topic of PointCloud2.",
                )
            return named
        if not topics:
            raise MissingStream(
                "has no clouds of a 3D LiDAR.",
                file=self._recording.path,
                advice="Record its PointCloud2 and the JointState of the axis.",
            )
        best = max(topics, key=lambda topic: topic.count)
        if len(topics) > 1:
            self.notes.append(f"of {len(topics)} topics of clouds {best.name} is taken")
        return best.name

    def _first_frame(self) -> str:
        for message in self._recording.messages([self.topic]):
            if isinstance(message.value, PointCloud):
                return frame_name(message.value.frame_id)
        raise MissingStream(
            f"{self.topic} has no cloud that can be read.", file=self._recording.path
        )

    def _find_axis(self, joint: str | None) -> RecordedAxis:
        static = next(
            (t.name for t in self._recording.topics if t.role == "tf_static" and t.count > 0), None
        )
        transforms = RecordedTransforms(self._recording, static)
        joints = self._joint_angles()
        if joint is not None and joint not in joints:
            raise MissingStream(
                f"no JointState has angles of a joint {joint!r}.",
                file=self._recording.path,
                advice=f"It has {', '.join(sorted(joints)) or 'none'}.",
            )
        if joints:
            name = joint or max(joints, key=lambda n: float(np.ptp(joints[n].angles_rad)))
            if joint is None and len(joints) > 1:
                self.notes.append(f"of {len(joints)} joints {name} turns most, and is taken")
            root = transforms.root_of(self.frame)
            T_axis_lidar = None
            if root != self.frame:
                T_axis_lidar = transforms.tree.lookup(root, self.frame, 0)
            return RecordedAxis(
                angles=joints[name], T_axis_lidar=T_axis_lidar, source=f"the joint {name}"
            )
        return self._axis_of_transforms(transforms)

    def _joint_angles(self) -> dict[str, AxisAngles]:
        topics = [t.name for t in self._recording.topics if t.role == "joints" and t.count > 0]
        stamps: dict[str, list[int]] = {}
        angles: dict[str, list[float]] = {}
        for message in self._recording.messages(topics) if topics else ():
            sample = message.value
            if isinstance(sample, JointSample) and sample.positions is not None:
                for name, angle in zip(sample.names, sample.positions.tolist(), strict=True):
                    stamps.setdefault(name, []).append(sample.stamp_ns)
                    angles.setdefault(name, []).append(angle)
        return {
            name: make_axis_angles(np.array(stamps[name]), np.array(angles[name]))
            for name in stamps
            if np.isfinite(angles[name]).any()
        }

    def _axis_of_transforms(self, transforms: RecordedTransforms) -> RecordedAxis:
        """The frame that turns, above the LiDAR's, and the mounting of the LiDAR on it."""
        turning = transforms.root_of(self.frame)
        stamps: dict[str, list[int]] = {}
        poses: dict[str, list[FloatArray]] = {}
        topics = [t.name for t in self._recording.topics if t.role == "tf" and t.count > 0]
        for message in self._recording.messages(topics) if topics else ():
            if isinstance(message.value, TransformBatch):
                for sample in message.value.transforms:
                    if frame_name(sample.child) == turning:
                        parent = frame_name(sample.parent)
                        stamps.setdefault(parent, []).append(sample.stamp_ns)
                        poses.setdefault(parent, []).append(sample.T_parent_child)
        if not stamps:
            raise MissingStream(
                "has no angles of the axis: neither a JointState nor a TF that turns "
                f"{turning or 'the frame of the clouds'}.",
                file=self._recording.path,
                advice="Record the joint of the turning axis (sensor_msgs/JointState).",
            )
        parent = max(stamps, key=lambda name: len(stamps[name]))
        found = find_rotation_axis(np.array(stamps[parent]), np.stack(poses[parent]))
        return RecordedAxis(
            angles=found.angles,
            T_axis_lidar=self._mounting(transforms, turning, found),
            source=f"the transform from {parent} to {turning}",
        )

    def _mounting(
        self, transforms: RecordedTransforms, turning: str, found: RotatingFrame
    ) -> FloatArray:
        if turning == self.frame:
            return found.T_axis_frame
        try:
            return found.T_axis_frame @ transforms.tree.lookup(turning, self.frame, 0)
        except FramesNotConnected as error:
            raise CalibrationFailed(error.problem, file=self._recording.path) from error
