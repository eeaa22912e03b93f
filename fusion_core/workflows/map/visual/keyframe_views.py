"""The keyframes' images with their poses, decoded again when they are needed."""

from collections.abc import Callable, Iterator

import numpy as np

from fusion_core.mapping.depth_camera import depth_intrinsics
from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics


class KeyframeViews:
    """Pairs of an image and its (4, 4) T_map_camera, any number of times, one in memory at a time.

    ``read_frame``: the frame of a stamp. ``stamps_ns``: (K,) of the keyframes, ascending.
    ``T_map_camera``: (K, 4, 4).
    """

    def __init__(
        self, read_frame: Callable[[int], RgbdFrame], stamps_ns: IntArray, T_map_camera: FloatArray
    ) -> None:
        self._read_frame = read_frame
        self._stamps_ns, self._T_map_camera = stamps_ns, T_map_camera

    def __len__(self) -> int:
        return len(self._stamps_ns)

    def __iter__(self) -> Iterator[tuple[RgbdFrame, FloatArray]]:
        for stamp_ns, T_map_camera in zip(
            self._stamps_ns.tolist(), self._T_map_camera, strict=True
        ):
            yield self._read_frame(stamp_ns), T_map_camera

    def spread(self, count: int) -> "KeyframeViews":
        """At most ``count`` of them, spread evenly."""
        chosen = np.linspace(0, len(self) - 1, min(len(self), count)).astype(np.int64)
        return KeyframeViews(self._read_frame, self._stamps_ns[chosen], self._T_map_camera[chosen])

    def depth_intrinsics(self, intrinsics: CameraIntrinsics) -> CameraIntrinsics:
        """Those of the grey images for depth images, whose size may differ."""
        first = self._read_frame(int(self._stamps_ns[0]))
        return depth_intrinsics(intrinsics, first.depth_m.shape)
