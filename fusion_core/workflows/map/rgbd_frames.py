"""Grey images with depth for visual odometry, from a recording's colour and depth topics."""

from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from typing import Literal

import cv2
import numpy as np

from fusion_core.model.conventions import NS_PER_MS, NS_PER_S, ByteArray, FloatArray
from fusion_core.model.errors import MissingStream, RecordingError
from fusion_core.model.geometry import invert_transform, make_transform
from fusion_core.model.recording import Recording
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import (
    CameraInfo,
    CameraIntrinsics,
    ColorImage,
    DepthImage,
    SensorValue,
)
from fusion_core.model.stamps import nearest_stamp
from fusion_core.recordings.topics import Streams
from fusion_core.workflows.fuse.align import mount_not_used
from fusion_core.workflows.fuse.camera_rig import build_camera_rig
from fusion_core.workflows.fuse.session import session_of
from fusion_core.workflows.fuse.settings import ChainSettings
from fusion_core.workflows.map.extrinsics import CameraExtrinsics
from fusion_core.workflows.map.recorded_mount_check import recorded_mount_problem
from fusion_core.workflows.recorded_transforms import frame_name
from fusion_core.workflows.sensor_geometry import first_value
from fusion_core.workflows.stamp_filter import StampFilter

# A little over one period of a 30 Hz camera: the largest gap of unsynchronised colour and depth.
COLOR_GAP_MAX_NS = 40 * NS_PER_MS
# A depth image waits for a colour image that is logged after it, so many images at most.
_DEPTH_WAITING = 8
# VGA, at which ORB-SLAM2 and the TUM benchmark work: more pixels cost time without better features.
_WIDTH_MAX_PX = 640
# Images of one camera in two sizes may differ by rounded or cropped rows.
_ASPECT_TOLERANCE = 0.02

Purpose = Literal["Visual odometry", "Visual SLAM"]
_REMEDIES: dict[Purpose, str] = {
    "Visual odometry": "choose another --motion",
    "Visual SLAM": "choose another --slam, for a recording with a LiDAR",
}


class RgbdFrames:
    """The images of the first depth camera, any number of times, one in memory at a time.

    ``intrinsics``: of the grey images, stored as they are, with their distortion. ``notes``: for
    people. ``clock_offset_ns``: camera stamp - LiDAR stamp of the same instant, taken off the
    stamps.

    Raises MissingStream where the recording lacks colour, depth or intrinsics.
    """

    def __init__(
        self,
        recording: Recording,
        streams: Streams,
        *,
        clock_offset_ns: int = 0,
        purpose: Purpose = "Visual odometry",
    ) -> None:
        self._recording, self._clock_offset_ns = recording, clock_offset_ns
        self._purpose, self._remedy = purpose, _REMEDIES[purpose]
        self._order = StampFilter(recording)
        if not streams.depth:
            raise MissingStream(
                "has no depth images.",
                file=recording.path,
                advice=f"{purpose} needs colour and depth: {self._remedy}.",
            )
        self._depth, color = streams.depth[0], streams.color[0]
        if color is None:
            raise MissingStream(
                f"has no colour images beside {self._depth}.",
                file=recording.path,
                advice=f"{purpose} needs both, the colour topic below the same name as the depth "
                f"topic (/camera/depth/..., /camera/color/...): {self._remedy}.",
            )
        self._color = color
        self.notes: tuple[str, ...] = ()
        if len(streams.depth) > 1:
            self.notes = (f"{purpose} follows {self._color} alone.",)
        self.intrinsics = self._intrinsics(streams.camera_info[0])

    @property
    def image_count(self) -> int | None:
        """Depth images in the recording, None where its index does not say; those without colour
        count too."""
        return next(
            (topic.count for topic in self._recording.topics if topic.name == self._depth), None
        )

    def _intrinsics(self, info_topic: str | None) -> CameraIntrinsics:
        depth, color = (first_value(self._recording, name) for name in (self._depth, self._color))
        info = None if info_topic is None else first_value(self._recording, info_topic)
        if not isinstance(depth, DepthImage) or not isinstance(color, ColorImage):
            raise MissingStream(
                f"{self._depth} or {self._color} holds no image that can be read.",
                file=self._recording.path,
            )
        intrinsics = info.intrinsics if isinstance(info, CameraInfo) else None
        if intrinsics is None or (intrinsics.height, intrinsics.width) != depth.depth_m.shape:
            raise MissingStream(
                f"{self._depth} has no usable intrinsics.",
                file=self._recording.path,
                advice=f"{self._purpose} needs them: {self._remedy}.",
            )
        height, width = color.rgb.shape[:2]
        of_depth, of_color = height * intrinsics.width, width * intrinsics.height
        if abs(of_depth - of_color) > _ASPECT_TOLERANCE * of_depth:
            raise MissingStream(
                f"{self._color} of {width} x {height} pixels does not show what {self._depth} of "
                f"{intrinsics.width} x {intrinsics.height} does.",
                file=self._recording.path,
                advice="Record depth registered to colour.",
            )
        if frame_name(color.frame_id) != frame_name(depth.frame_id):
            self.notes += (
                f"{self._color} is taken to show what {self._depth} does, though their frames "
                f"{color.frame_id} and {depth.frame_id} differ.",
            )
        return intrinsics.scaled_to(_scaled_shape(height, width))

    def __iter__(self) -> Iterator[RgbdFrame]:
        """Depth images, each with the colour image nearest in time; those without one are left
        out, and so is what is stamped out of order."""
        waiting: deque[DepthImage] = deque()
        colors: deque[ColorImage] = deque(maxlen=2 * _DEPTH_WAITING)
        for message in self._order.accepted(self._recording.messages([self._depth, self._color])):
            value = message.value
            if isinstance(value, DepthImage):
                waiting.append(value)
            elif isinstance(value, ColorImage):
                colors.append(value)
            # Once a later colour image is read, none nearer can follow.
            while waiting and (
                (colors and colors[-1].stamp_ns >= waiting[0].stamp_ns)
                or len(waiting) > _DEPTH_WAITING
            ):
                frame = self._joined_frame(waiting.popleft(), colors)
                if frame is not None:
                    yield frame
        for depth in waiting:
            frame = self._joined_frame(depth, colors)
            if frame is not None:
                yield frame

    def at(self, stamp_ns: int) -> RgbdFrame:
        """The frame of a stamp that iteration gives, read alone.

        Raises MissingStream where there is none.
        """
        recorded_ns = stamp_ns + self._clock_offset_ns
        depth = self._nearest(self._depth, recorded_ns, 0)
        color = self._nearest(self._color, recorded_ns, COLOR_GAP_MAX_NS)
        frame = None
        if isinstance(depth, DepthImage) and isinstance(color, ColorImage):
            frame = self._joined_frame(depth, deque([color]))
        if frame is None:
            raise MissingStream(
                f"has no colour image with depth at {stamp_ns / NS_PER_S:.3f} s.",
                file=self._recording.path,
            )
        return frame

    def _nearest(self, topic: str, stamp_ns: int, gap_max_ns: int) -> SensorValue | None:
        """Of the messages that can be read and are stamped in order, the nearest to an instant."""
        away_ns = np.abs(self._recording.stamps_ns(topic) - stamp_ns)
        near = np.flatnonzero(self._order.in_order(topic) & (away_ns <= gap_max_ns))
        for index in near[np.argsort(away_ns[near], kind="stable")].tolist():
            # Iteration warns of damaged messages.
            with suppress(RecordingError):
                return self._recording.read(topic, index).value
        return None

    def _joined_frame(self, depth: DepthImage, colors: deque[ColorImage]) -> RgbdFrame | None:
        nearest = nearest_stamp(
            [image.stamp_ns for image in colors], depth.stamp_ns, COLOR_GAP_MAX_NS
        )
        if nearest is None:
            return None
        color = colors[nearest]
        height, width = _scaled_shape(*color.rgb.shape[:2])
        if (height, width) != (self.intrinsics.height, self.intrinsics.width):
            # Of another rig than the first.
            return None
        rgb = reduce_image(color.rgb, (height, width))
        gray: ByteArray = np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
        stamp_ns = depth.stamp_ns - self._clock_offset_ns
        return RgbdFrame(stamp_ns=stamp_ns, gray=gray, depth_m=depth.depth_m, rgb=rgb)


def reduce_image(rgb: ByteArray, shape: tuple[int, int]) -> ByteArray:
    """The image with ``shape`` (height, width)."""
    if rgb.shape[:2] == shape:
        return rgb
    return np.asarray(cv2.resize(rgb, shape[::-1], interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _scaled_shape(height: int, width: int) -> tuple[int, int]:
    """The (height, width) to which an image is reduced."""
    if width <= _WIDTH_MAX_PX:
        return height, width
    return round(height * _WIDTH_MAX_PX / width), _WIDTH_MAX_PX


def first_camera_extrinsics(
    recording: Recording, streams: Streams, extrinsics: CameraExtrinsics | None
) -> tuple[FloatArray | None, tuple[str, ...]]:
    """(4, 4) T_lidar_camera of the first depth camera's stored images, by ``extrinsics`` or by the
    recording's own transforms; None where neither gives it. And notes for people."""
    if not streams.depth:
        return None, ()
    if extrinsics is not None:
        placed = [camera for camera in extrinsics.cameras if camera.topic == streams.depth[0]]
        if not placed:
            return None, ()
        T_view_stored = invert_transform(make_transform(placed[0].view.R_stored_view, np.zeros(3)))
        return placed[0].T_lidar_camera @ T_view_stored, ()
    if streams.lidar is None:
        return None, ()
    settings = ChainSettings()
    rig = build_camera_rig(recording, streams, settings.sampling)
    if rig.recorded_mount is None:
        return None, ()
    refusal = recorded_mount_problem(session_of(recording, streams, rig, settings))
    if refusal:
        return None, (mount_not_used(refusal),)
    T_view_stored = invert_transform(make_transform(rig.views[0].R_stored_view, np.zeros(3)))
    return rig.recorded_mount.T_lidar_rig @ rig.cameras[0].T_rig_camera @ T_view_stored, ()
