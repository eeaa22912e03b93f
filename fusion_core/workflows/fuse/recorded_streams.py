"""A recording opened for display: whatever it holds, and why the chain cannot work on it if so."""

from dataclasses import dataclass, replace

from fusion_core.model.errors import MissingStream
from fusion_core.model.given_extrinsics import GivenExtrinsics
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import PoseSample
from fusion_core.recordings.topics import Streams, choose_streams
from fusion_core.workflows.fuse.camera_rig import build_camera_rig
from fusion_core.workflows.fuse.session import FuseOptions, Session, open_session, session_of
from fusion_core.workflows.fuse.settings import ChainSettings
from fusion_core.workflows.recorded_transforms import frame_name
from fusion_core.workflows.sensor_geometry import first_scan, first_value


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedStreams:
    """What a recording holds, with the topics that are used.

    ``session``: with its depth images, None where it has none that can be read. ``why_not_fused``:
    the reason why the chain cannot work on it, a sentence for people; empty where it can.
    ``unreadable``: what is wrong with a sensor that is there and cannot be read, else empty.
    ``body_frame``: the frame whose poses are looked up, the LiDAR's or, without one, odometry's.
    """

    recording: Recording
    streams: Streams
    session: Session | None
    why_not_fused: str
    body_frame: str
    unreadable: str = ""


def open_recorded_streams(
    recording: Recording,
    options: FuseOptions,
    settings: ChainSettings,
    given: GivenExtrinsics | None = None,
) -> RecordedStreams:
    """Choose the streams, and build the rig as far as there is one. ``given``: as ``open_session``.

    Raises MissingStream for a topic that is not there or of another kind, and for a virtual LiDAR
    without depth images, SettingsError for extrinsics that are not of these cameras.
    """
    try:
        session = open_session(recording, options, settings, given)
    except MissingStream as error:
        # A wrong name has no streams at all: it is reported.
        streams = choose_streams(
            recording, lidar=options.lidar_topic, depth=options.depth_topics or None
        )
        if options.virtual_lidar_row is not None:
            raise
        return _without_chain(recording, streams, settings, error)
    return RecordedStreams(
        recording=recording,
        streams=session.streams,
        session=session,
        why_not_fused="",
        body_frame=session.rig.lidar_frame,
    )


def _without_chain(
    recording: Recording, streams: Streams, settings: ChainSettings, error: MissingStream
) -> RecordedStreams:
    """What can be shown of a recording that lacks a sensor, or the readable messages of one."""
    body_frame = unreadable = ""
    if streams.lidar is not None:
        try:
            body_frame = first_scan(recording, streams.lidar).frame_id
        except MissingStream as found:
            unreadable = found.problem
            streams = replace(streams, lidar=None)
    session = None
    if streams.depth:
        try:
            rig = build_camera_rig(
                recording, replace(streams, lidar=None), settings.sampling, needs_lidar=False
            )
            session = session_of(recording, replace(streams, lidar=None), rig, settings)
        except MissingStream as found:
            unreadable = unreadable or found.problem
            streams = replace(streams, depth=(), color=(), camera_info=())
    if streams.lidar is None and streams.odometry is not None:
        sample = first_value(recording, streams.odometry)
        body_frame = frame_name(sample.child) if isinstance(sample, PoseSample) else ""
    return RecordedStreams(
        recording=recording,
        streams=streams,
        session=session,
        why_not_fused=unreadable or _reason(recording, streams, error),
        body_frame=body_frame,
        unreadable=unreadable,
    )


def _reason(recording: Recording, streams: Streams, error: MissingStream) -> str:
    """Why nothing can be compared. An error's own advice names options of the command line."""
    if not any(topic.count for topic in recording.topics):
        return "The recording holds no messages: there is nothing to match."
    if streams.lidar is None and not streams.depth:
        return "The recording has neither a 2D LiDAR nor a depth camera: there is nothing to match."
    if not streams.depth:
        return "The recording has no depth camera: there is nothing to match the LiDAR with."
    if streams.lidar is None:
        return "The recording has no 2D LiDAR: there is nothing to match the depth images with."
    return error.problem
