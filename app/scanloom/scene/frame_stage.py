"""What the scene draws of a computed frame: the geometry of its cameras, and colours."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import ByteArray, IntArray
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.rig import Mount
from fusion_core.model.sensors import ColorImage, DepthImage
from fusion_core.workflows.lone_stream import LoneStream
from scanloom.frame_view import FrameView
from scanloom.scene.color_picture import upright_color
from scanloom.scene.depth_surface import (
    colors_by_depth,
    colors_by_image,
    is_registered,
    muted,
)
from scanloom.scene.frame_geometry import (
    FrameGeometry,
    UnmatchedFrame,
    frame_geometry,
    robot_geometry,
    scan_geometry,
    unmatched_geometry,
)
from scanloom.scene.stage_colors import stage_colors
from scanloom.state.raw_frame import LoneFrame
from scanloom.state.view import PanelName

# Steps whose marks have colours of their own, under which the surface is grey.
_MARKING_STEPS: frozenset[PanelName] = frozenset({"Register", "Repair", "Review"})
# The depths of a frame, without speckle, over which a surface is coloured.
_DEPTH_PERCENTS = (2.0, 98.0)
_DEFAULT_SPAN_M = (0.5, 8.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class StagedCamera:
    """What a camera sees. ``color``: its colour image, if that shows the depth image's view."""

    geometry: FrameGeometry
    color: ColorImage | None


def staged_frame(frame_view: FrameView, *, with_rows: bool) -> StagedCamera | None:
    """The frame, without pairs if it could not be matched; None if it could not be read.
    ``with_rows``: whether rows of its image are drawn."""
    mount, view, paired = _mount(frame_view), frame_view.view, frame_view.paired
    if frame_view.lone is not None:
        return StagedCamera(geometry=_lone_geometry(frame_view, frame_view.lone), color=None)
    if mount is None or paired is None:
        return None
    session = frame_view.session
    row_step = view.row_step if with_rows else None
    if frame_view.chain is not None and frame_view.frame is not None:
        geometry = frame_geometry(
            frame_view.frame,
            session.rig,
            frame_view.chain.alignment,
            row_step=row_step,
            classes=view.visible_classes,
            repaired=view.show_repaired,
        )
    else:
        unmatched = UnmatchedFrame(
            camera=paired.camera,
            stamp_ns=paired.image.stamp_ns,
            depth_m=session.depth_of(paired.camera, paired.image.depth_m),
            scan=None if paired.window is None else paired.window.scan,
            mount=mount,
            has_lidar=session.streams.lidar is not None or session.virtual_row is not None,
        )
        geometry = unmatched_geometry(unmatched, session.rig, row_step=row_step)
    color = _registered(frame_view.color, paired.image)
    return StagedCamera(geometry=geometry, color=color)


def other_cameras(
    frame_view: FrameView, is_shown: Callable[[int, int], bool]
) -> Iterator[StagedCamera]:
    """What the other cameras see at the frame's instant, where there are several and
    ``is_shown(camera, stamp_ns)`` does not hold."""
    frames, number = frame_view.open_recording.frames, frame_view.view.frame_index
    mount = _mount(frame_view)
    if isinstance(frames, LoneStream) or frame_view.paired is None or mount is None:
        return
    session = frame_view.session
    if len(session.rig.cameras) == 1:
        return
    for other in frames.panorama(number):
        if other == number or is_shown(frames.camera_of(other), int(frames.times_ns[other])):
            continue
        try:
            image, color = frames.image(other), frames.color(other)
        except ScanLoomError:
            # It is said when that frame is looked at.
            continue
        camera = frames.camera_of(other)
        unmatched = UnmatchedFrame(
            camera=camera,
            stamp_ns=image.stamp_ns,
            depth_m=session.depth_of(camera, image.depth_m),
            scan=None,
            mount=mount,
        )
        yield StagedCamera(
            geometry=unmatched_geometry(unmatched, session.rig, row_step=None),
            color=_registered(color, image),
        )


def surface_colors(
    staged: StagedCamera, frame_view: FrameView, span_m: tuple[float, float]
) -> ByteArray:
    """(N, 3) colours of a surface: by its colour image, else by depth over ``span_m``; nearly grey
    in the steps that mark classes."""
    surface = staged.geometry.surface
    if staged.color is not None and staged.geometry.camera is not None:
        rig = frame_view.session.rig
        image = upright_color(staged.color.rgb, rig, staged.geometry.camera)
        colors = colors_by_image(surface, image)
    else:
        colors = colors_by_depth(surface, *span_m)
    if frame_view.view.panel in _MARKING_STEPS:
        colors = muted(colors, stage_colors(frame_view.is_dark).surface)
    return colors


def depth_span_m(geometry: FrameGeometry) -> tuple[float, float]:
    """Between which depths most of a surface lies."""
    depth_m = geometry.surface.depth_m
    if not depth_m.size:
        return _DEFAULT_SPAN_M
    near_m, far_m = np.percentile(depth_m, _DEPTH_PERCENTS)
    return float(near_m), float(far_m)


def pose_stamp_ns(frame_view: FrameView) -> int | None:
    """The stamp at which the LiDAR's pose is looked up: that of the scan that is drawn."""
    if frame_view.match is not None:
        return frame_view.match.scan.stamp_ns
    if frame_view.lone is not None:
        return frame_view.lone.stamp_ns
    if frame_view.raw is None:
        return None
    scan = frame_view.raw.scan
    return frame_view.raw.stamp_ns if scan is None else scan.stamp_ns


def pose_stamps_ns(frame_view: FrameView) -> IntArray:
    """(N,) the stamps of a trajectory, about those of the frames."""
    frames = frame_view.open_recording.frames
    return frames.stamps_ns() if isinstance(frames, LoneStream) else frames.times_ns


def _lone_geometry(frame_view: FrameView, lone: LoneFrame) -> FrameGeometry:
    if lone.scan is not None:
        return scan_geometry(lone.scan)
    poses = frame_view.open_recording.poses
    pose = None if poses is None else poses.at(lone.stamp_ns)
    at_m = None if pose is None else (float(pose[0]), float(pose[1]))
    return robot_geometry(lone.stamp_ns, at_m)


def _mount(frame_view: FrameView) -> Mount | None:
    """The mount at which a frame is drawn, None where there is nothing to draw."""
    if frame_view.chain is not None:
        return frame_view.chain.alignment.mount
    return None if frame_view.raw is None else frame_view.raw.mount


def _registered(color: ColorImage | None, image: DepthImage) -> ColorImage | None:
    if color is None or not is_registered(color, image):
        return None
    return color
