"""The images of keyframes are found again by their stamps, as visual SLAM saw them."""

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from fusion_core.model.conventions import NS_PER_MS, NS_PER_S
from fusion_core.model.errors import MissingStream
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.map.image_lookup import ImageLookup
from fusion_core.workflows.map.rgbd_frames import RgbdFrames
from fusion_core.workflows.map.visual.color_registration import RegisteredFrames

LENS = CameraIntrinsics(width=160, height=120, fx=120.0, fy=118.0, cx=80.5, cy=58.0)


@pytest.mark.data
def test_an_image_is_the_one_that_was_tracked(data_folder: Path) -> None:
    with open_recording(data_folder / "real" / "rgbd" / "seven_scenes") as recording:
        streams = choose_streams(recording, lidar=None, depth=None)
        offset_ns = 500 * NS_PER_MS
        images = ImageLookup(recording, streams, clock_offset_ns=offset_ns, color_zoom=1.1)
        recorded = RgbdFrames(recording, streams, clock_offset_ns=offset_ns)
        frames = RegisteredFrames(frames=recorded, intrinsics=recorded.intrinsics, zoom=1.1)
        for number, frame in enumerate(frames):
            if number in (0, 7):
                np.testing.assert_array_equal(images.at(frame.stamp_ns), frame.rgb)
            if number == 7:
                break
        with pytest.raises(MissingStream, match="has no colour image at"):
            images.at(10**6 * NS_PER_S)


@pytest.mark.data
def test_a_frame_is_read_alone_as_in_the_whole(data_folder: Path) -> None:
    with open_recording(data_folder / "real" / "rgbd" / "redwood_and_odd_encodings") as recording:
        recorded = RgbdFrames(recording, choose_streams(recording), clock_offset_ns=70 * NS_PER_MS)
        frames = RegisteredFrames(frames=recorded, intrinsics=recorded.intrinsics, zoom=0.9)
        for frame in islice(frames, 0, None, 2):
            alone = frames.at(frame.stamp_ns)
            assert alone.stamp_ns == frame.stamp_ns
            for image in ("gray", "depth_m", "rgb"):
                np.testing.assert_array_equal(getattr(alone, image), getattr(frame, image))
        with pytest.raises(MissingStream, match="has no colour image with depth at"):
            recorded.at(frame.stamp_ns + 1)
