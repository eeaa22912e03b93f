"""A check of the recorded mount with the first scans and images, without a full alignment."""

from itertools import islice

from fusion_core.alignment.mount_cost import MountCost
from fusion_core.alignment.recorded_mount import find_refusal
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.align import observe_mount
from fusion_core.workflows.fuse.session import Session


def recorded_mount_problem(session: Session) -> str:
    """Why the mount by the recording's own transforms is not to be used, as part of a sentence;
    "" where it is, or where nothing can be compared with it.

    As many images are read as a refinement keeps.
    """
    recorded, settings = session.rig.recorded_mount, session.settings
    if recorded is None or not all(camera.calibrated for camera in session.rig.cameras):
        return ""
    frames = []
    images = (entry for entry in session.pairs() if not isinstance(entry, LaserScan))
    for entry in islice(images, settings.mount.frames):
        pair = session.frame_pair(entry)
        if pair is not None:
            frames.append(observe_mount(pair, settings))
    if not any(frame.points_m.size for frame in frames):
        return ""
    return find_refusal(MountCost(frames, settings.mount), recorded, settings.mount, None)
