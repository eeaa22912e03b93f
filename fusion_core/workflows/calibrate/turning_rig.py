"""Which recordings are of a 3D LiDAR on a turning axis with a camera."""

from fusion_core.model.recording import Recording


def image_topic_of(recording: Recording) -> str:
    """The topic of colour images with which a recorded turn of a 3D LiDAR can be calibrated; empty
    where the recording has no clouds, no angles of the axis, no images or no intrinsics."""
    counted = [topic for topic in recording.topics if topic.count]
    roles = {topic.role for topic in counted}
    if not {"points", "joints", "color", "camera_info"} <= roles:
        return ""
    return next(topic.name for topic in counted if topic.role == "color")
