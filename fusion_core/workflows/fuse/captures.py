"""Which recorded samples a frame is about: its beams and pixels as a person's labels name them.

A label names the scan by its stamp and its number among the scans of that stamp, and a pixel where
the camera stored it. Both are the same whether frames are read in a pass or one by one, and do not
change with the mount or with a setting.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.alignment.upright import UprightView
from fusion_core.model.conventions import IntArray, read_only
from fusion_core.model.labels import Capture
from fusion_core.model.sensors import DepthImage, LaserScan
from fusion_core.workflows.fuse.frame_match import FrameMatch
from fusion_core.workflows.fuse.session import Session


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameCaptures:
    """The captures of a matched frame, and the place of each of its B pairs in them.

    ``scan``: None where the curve is cut from the depth itself: it is no measurement of its own.
    ``beam``: (B,) beam of the scan. ``row``, ``column``: (B,) pixel of the stored image, -1 where a
    beam has none. ``view``: which stored pixel each pixel of the upright image is, and the reverse.
    """

    scan: Capture | None
    image: Capture
    beam: IntArray
    row: IntArray
    column: IntArray
    view: UprightView

    def __post_init__(self) -> None:
        for array in (self.beam, self.row, self.column):
            read_only(array)


def frame_captures(match: FrameMatch, session: Session) -> FrameCaptures:
    """The captures of a frame that ``session`` has matched; of a panorama's image its own."""
    camera, pairs = match.pair.camera_index, match.correspondence
    view = session.rig.views[camera]
    row, column = view.stored_pixels(pairs.row, pairs.column)
    return FrameCaptures(
        scan=scan_capture(match.scan, session),
        image=image_capture(match.pair.image, camera, session),
        beam=pairs.beam.copy(),
        row=row.copy(),
        column=column.copy(),
        view=view,
    )


def scan_capture(scan: LaserScan, session: Session) -> Capture | None:
    """The capture of a scan that a frame is paired with; None for one of a virtual LiDAR."""
    topic = session.streams.lidar
    if topic is None or session.virtual_row is not None:
        return None
    # The chain uses one scan of each stamp, the one that is in order.
    alike = np.flatnonzero(session.recording.stamps_ns(topic) == scan.stamp_ns)
    index = 0
    if alike.size > 1:
        used = [session.geometry_filter.is_in_order(topic, int(number)) for number in alike]
        index = used.index(True) if any(used) else 0
    return Capture("lidar", topic, scan.stamp_ns, index, 1, scan.ranges_m.size)


def image_capture(image: DepthImage, camera: int, session: Session) -> Capture:
    """The capture of a stored depth image of the rig's camera number ``camera``."""
    rows, columns = image.depth_m.shape
    return Capture("depth", session.rig.cameras[camera].topic, image.stamp_ns, 0, rows, columns)
