"""The keyframes' images with their poses, decoded again when they are needed."""

from collections.abc import Iterable, Iterator

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.workflows.map.rgbd_frames import scaled_intrinsics


class KeyframeViews:
    """Pairs of an image and its (4, 4) T_map_camera, any number of times, one in memory at a time.

    ``stamps_ns``: (K,) of the keyframes, ascending; ``T_map_camera``: (K, 4, 4).
    """

    def __init__(
        self, frames: Iterable[RgbdFrame], stamps_ns: IntArray, T_map_camera: FloatArray
    ) -> None:
        self._frames = frames
        self._poses = dict(zip(stamps_ns.tolist(), T_map_camera, strict=True))

    def __len__(self) -> int:
        return len(self._poses)

    def __iter__(self) -> Iterator[tuple[RgbdFrame, FloatArray]]:
        for frame in self._frames:
            pose = self._poses.get(frame.stamp_ns)
            if pose is not None:
                yield frame, pose

    def depth_intrinsics(self, intrinsics: CameraIntrinsics) -> CameraIntrinsics:
        """Those of the grey images for depth images, whose size may differ."""
        for frame, _ in self:
            return scaled_intrinsics(intrinsics, frame.depth_m.shape)
        return intrinsics
