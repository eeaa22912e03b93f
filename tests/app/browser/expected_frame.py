"""A frame as the core alone computes it, and the picture that the Repair panel should show."""

import numpy as np

from fusion_core.workflows.fuse.frame import FusedFrame, classify_and_repair
from scanloom.frame_view import FrameView
from scanloom.plots.depth_image import DepthPicture, PairOverlay, depth_limits_m, depth_picture
from scanloom.plots.pair_pixels import pixels_of_match, repaired_depth_m
from scanloom.state.view import View
from tests.app.browser.person import match_of

# In this frame of the recording, beams and pixels are of all classes.
NUMBER = 12
# More than any picture needs: its width alone decides.
_ROOM_PX = 1000


def expected_frame(frame_view: FrameView, view: View) -> FusedFrame:
    """The frame of a view, whatever the server has kept of it."""
    assert frame_view.chain is not None
    return classify_and_repair(
        match_of(frame_view, view), frame_view.chain.alignment, view.settings
    )


def repaired_picture(frame: FusedFrame, view: View, like: np.ndarray) -> DepthPicture:
    """The panel's second picture where both are shown, as wide as another one."""
    return depth_picture(
        "After: repaired",
        repaired_depth_m(frame),
        PairOverlay(pixels=pixels_of_match(frame.match, frame), classes=view.visible_classes),
        width_px=like.shape[1],
        height_px=_ROOM_PX,
        limits_m=depth_limits_m(frame.match.depth_m),
    )
