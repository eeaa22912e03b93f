"""Colour images that show what the depth images do, where the recorded ones show more or less."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray
from fusion_core.model.progress import Progress, silent
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.slam.visual.color_zoom import ColorZoom, estimate_color_zoom
from fusion_core.slam.visual.visual_slam import VisualSlamSettings
from fusion_core.workflows.map.rgbd_frames import RgbdFrames


@dataclass(frozen=True, slots=True, kw_only=True)
class RegisteredFrames:
    """Frames, any number of times, with their colour images magnified by ``zoom`` about the
    principal point."""

    frames: RgbdFrames
    intrinsics: CameraIntrinsics
    zoom: float = 1.0
    notes: tuple[str, ...] = ()

    def __iter__(self) -> Iterator[RgbdFrame]:
        return map(self._registered, self.frames)

    def at(self, stamp_ns: int) -> RgbdFrame:
        """The frame of a stamp."""
        return self._registered(self.frames.at(stamp_ns))

    def _registered(self, frame: RgbdFrame) -> RgbdFrame:
        return replace(
            frame,
            gray=magnify(frame.gray, self.zoom, self.intrinsics),
            rgb=None if frame.rgb is None else magnify(frame.rgb, self.zoom, self.intrinsics),
        )


def register_colors(
    frames: RgbdFrames,
    intrinsics: CameraIntrinsics,
    settings: VisualSlamSettings,
    progress: Progress = silent,
) -> RegisteredFrames:
    """The frames as they are, unless colour and depth are certain to show different parts."""
    found = estimate_color_zoom(
        frames,
        intrinsics,
        settings.color_zoom,
        settings.features,
        settings.observation_noise,
        progress,
        image_count=frames.image_count,
    )
    if found is None or not found.is_significant:
        return RegisteredFrames(frames=frames, intrinsics=intrinsics)
    return RegisteredFrames(
        frames=frames, intrinsics=intrinsics, zoom=found.zoom, notes=(_note(found),)
    )


def magnify(image: ByteArray, zoom: float, intrinsics: CameraIntrinsics) -> ByteArray:
    """An image of (H, W) or (H, W, 3), of the same size; black where nothing is known."""
    if zoom == 1.0:
        return image
    shift = (1.0 - 1.0 / zoom) * np.array([intrinsics.cx, intrinsics.cy])
    source_of = np.array([[1.0 / zoom, 0.0, shift[0]], [0.0, 1.0 / zoom, shift[1]]])
    height, width = image.shape[:2]
    magnified = cv2.warpAffine(
        image, source_of, (width, height), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    )
    return np.asarray(magnified, np.uint8)


def _note(found: ColorZoom) -> str:
    return (
        f"Colour is not registered to depth: its focal length is {1.0 / found.zoom:.3f} ± "
        f"{found.sigma / found.zoom**2:.3f} of the given one (by {found.pairs} pairs of images). "
        "It was magnified to match; registered recordings serve better."
    )
