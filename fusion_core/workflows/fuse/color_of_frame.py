"""The colour image of a fused frame, in the upright view of its depth image."""

import numpy as np

from fusion_core.alignment.upright import UprightView
from fusion_core.model.conventions import ByteArray
from fusion_core.model.errors import RecordingError
from fusion_core.model.sensors import ColorImage
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.session import Session

# In the log, colour and depth images may be out of the order of their stamps by a few messages.
_COLOR_NEIGHBOURS = 3


def nearest_color_image(session: Session, frame: FusedFrame) -> ColorImage | None:
    """The colour image nearest in stamp among the few that were logged around the depth image."""
    match = frame.match
    topic = session.streams.color[
        session.streams.depth.index(session.rig.cameras[match.pair.camera_index].topic)
    ]
    if topic is None:
        return None
    logged_ns = session.recording.received_ns(topic)
    depth_ns = match.pair.image.received_ns
    place = int(np.searchsorted(logged_ns, match.stamp_ns if depth_ns is None else depth_ns))
    nearest: ColorImage | None = None
    for index in range(
        max(0, place - _COLOR_NEIGHBOURS), min(logged_ns.size, place + _COLOR_NEIGHBOURS)
    ):
        try:
            value = session.recording.read(topic, index).value
        except RecordingError:
            # A damaged image is no reason to fail; reading it has left its own warning.
            continue
        if isinstance(value, ColorImage) and (
            nearest is None
            or abs(value.stamp_ns - match.stamp_ns) < abs(nearest.stamp_ns - match.stamp_ns)
        ):
            nearest = value
    return nearest


def remap_color(rgb: ByteArray, view: UprightView) -> ByteArray:
    """A colour image in the depth image's upright view: pixel by pixel where both have one size,
    else only turned upright."""
    if rgb.shape[:2] != view.stored_shape:
        right_x, right_y = np.rint(view.R_stored_view[:2, 0]).astype(int)
        turns = {(1, 0): 0, (0, 1): 1, (-1, 0): 2, (0, -1): 3}[int(right_x), int(right_y)]
        return np.ascontiguousarray(np.rot90(rgb, turns))
    if view.stored_index is None:
        return rgb
    seen = rgb.reshape(-1, 3)[np.maximum(view.stored_index, 0)]
    return np.where(view.stored_index[..., np.newaxis] >= 0, seen, np.uint8(0))
