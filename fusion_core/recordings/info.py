"""What a recording holds and what can be done with it."""

from typing import Any

from fusion_core.model.conventions import NS_PER_S
from fusion_core.model.recording import Recording
from fusion_core.recordings.topics import Streams, choose_streams


def describe_recording(recording: Recording) -> dict[str, Any]:
    """A recording as plain values for JSON: times in nanoseconds, null where there is no clock.

    ``end_ns`` is the log time of the last message.
    """
    start_ns, end_ns = recording.start_ns, recording.end_ns
    duration_s = None
    if start_ns is not None and end_ns is not None:
        duration_s = (end_ns - start_ns) / NS_PER_S
    streams = choose_streams(recording)
    return {
        "format": recording.format,
        "start_ns": start_ns,
        "end_ns": end_ns,
        "duration_s": duration_s,
        "topics": [
            {
                "name": topic.name,
                "type": topic.type,
                "role": topic.role,
                "count": topic.count,
                "rate_hz": topic.rate_hz,
            }
            for topic in recording.topics
        ],
        "can": describe_capabilities(recording, streams),
        "warnings": list(recording.warnings),
    }


def describe_capabilities(recording: Recording, streams: Streams) -> list[str]:
    """Plain sentences: which work this recording supports, and why not the rest."""
    return [
        *_describe_fusion(streams),
        *_describe_pose_sources(recording, streams),
        *_describe_visual_slam(streams),
        *(["Its stamps are made from frame numbers."] if recording.stamps_are_nominal else []),
        *streams.notes,
    ]


def _describe_fusion(streams: Streams) -> list[str]:
    if not streams.depth and streams.lidar is None:
        return ["It cannot be fused: there is neither a 2D LiDAR nor a depth camera."]
    if not streams.depth:
        return [f"It cannot be fused: there is {streams.lidar}, but no depth camera."]
    without = [d for d, info in zip(streams.depth, streams.camera_info, strict=True) if not info]
    lacking = [f"{name} has no intrinsics: its rows are sampled by index." for name in without]
    depths = ", ".join(streams.depth)
    if streams.lidar is not None:
        return [f"It can be fused: {streams.lidar} with {depths}.", *lacking]
    if len(without) == len(streams.depth):
        return ["It cannot be fused: there is no 2D LiDAR, and a virtual one needs intrinsics."]
    return [
        f"It can be fused with a virtual LiDAR, cut from a row of {depths}: there is no 2D LiDAR.",
        *lacking,
    ]


def _describe_visual_slam(streams: Streams) -> list[str]:
    if not streams.depth:
        return []
    depth, color, intrinsics = streams.depth[0], streams.color[0], streams.camera_info[0]
    if color is None:
        return [f"It cannot be mapped by its images: {depth} has no colour images beside it."]
    if intrinsics is None:
        return [f"It cannot be mapped by its images: {depth} has no intrinsics."]
    return [f"It can be mapped by visual SLAM of its images, {color} with {depth}."]


def _describe_pose_sources(recording: Recording, streams: Streams) -> list[str]:
    if streams.lidar is None and not streams.depth:
        return []
    sources = [s for s in (streams.tf, streams.odometry) if s is not None]
    if sources:
        return [f"It can be mapped with the poses of {' or '.join(sources)}."]
    named = [t.name for t in recording.topics if t.role == "pose" and t.count > 0]
    if named:
        return [f"It can be mapped only if a pose topic is named: {', '.join(named)}."]
    return ["It cannot be mapped with recorded poses: there are none."]
