"""What a recording holds, in sentences."""

from fusion_core.workflows.fuse.session import Session
from scanloom.scene.duration_text import duration_text
from scanloom.state.open_recording import OpenRecording


def fused_sentence(open_recording: OpenRecording) -> str:
    """What a recording that can be fused holds."""
    session = open_recording.fuse_session
    images = _counted(open_recording, "depth image", _of_cameras(session))
    if session.virtual_row is not None:
        return f"{images}, row {session.virtual_row} as a virtual LiDAR"
    return f"{images}, and a LiDAR"


def alone_sentence(open_recording: OpenRecording) -> str:
    """What a recording that cannot be fused holds, and what it lacks."""
    opened = open_recording.opened
    streams = opened.streams
    if opened.session is not None:
        held = _counted(open_recording, "depth image", _of_cameras(opened.session))
        missing = "no LiDAR"
    elif streams.lidar is not None:
        held, missing = _counted(open_recording, "scan", "of a LiDAR"), "no depth camera"
    elif streams.odometry is not None:
        held = _counted(open_recording, "pose", "of the odometry")
        missing = "neither LiDAR nor depth camera"
    elif open_recording.has_turning_lidar:
        return "A turning 3D LiDAR and a camera: Calibrate finds their pose"
    elif not any(topic.count for topic in open_recording.recording.topics):
        return "The recording holds no messages: there is nothing to show"
    else:
        return "Nothing that can be shown: no LiDAR, no depth camera, no odometry"
    if opened.unreadable:
        missing = "nothing else can be read"
    return f"{held}; {missing}: nothing to match"


def notes_of_streams(open_recording: OpenRecording) -> str:
    """What cannot be read, which stream is used where there are several, and what is assumed of
    one; may be empty."""
    opened = open_recording.opened
    used = opened.streams.lidar
    lidars = [topic.name for topic in opened.recording.topics if topic.role == "lidar"]
    notes = [opened.unreadable] if opened.unreadable else []
    if used is not None and len(lidars) > 1 and not _has_virtual_lidar(opened.session):
        notes.append(f"Of {len(lidars)} LiDARs {used} is used: choose in “Streams to use”.")
    if opened.session is not None and not opened.session.rig.cameras[0].calibrated:
        fov_deg = opened.session.settings.sampling.assumed_fov_deg
        notes.append(
            f"The depth camera comes without intrinsics: a field of view of {fov_deg:g}° is "
            "assumed."
        )
    return " ".join(notes)


def _has_virtual_lidar(session: Session | None) -> bool:
    return session is not None and session.virtual_row is not None


def _of_cameras(session: Session) -> str:
    cameras = len(session.rig.cameras)
    return "of a depth camera" if cameras == 1 else f"of {cameras} depth cameras"


def _counted(open_recording: OpenRecording, what: str, whose: str) -> str:
    times_ns = open_recording.frames.times_ns
    count = len(times_ns)
    duration_s = float(times_ns[-1] - times_ns[0]) / 1e9 if count > 1 else 0.0
    plural = "" if count == 1 else "s"
    return f"{count:,} {what}{plural} {whose} in {duration_text(duration_s)}"
