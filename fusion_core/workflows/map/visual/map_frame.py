"""The frame of visual SLAM's results: z up, and the floor at 0 where it is seen."""

from dataclasses import dataclass

import numpy as np

from fusion_core.mapping.floor_in_map import FloorInMap, find_floor_in_map
from fusion_core.model.conventions import R_BODY_OPTICAL, FloatArray, read_only
from fusion_core.model.errors import AlignmentFailed
from fusion_core.model.geometry import make_transform
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.workflows.map.visual.keyframe_views import KeyframeViews

# Spread evenly over the keyframes: some of them show the floor.
_IMAGES_SAMPLED = 24
# The largest tilt between the floor and what is taken as up: a mount, or a camera in a hand.
_TILT_MAX_MOUNTED_RAD = np.deg2rad(15.0)
_TILT_MAX_RAD = np.deg2rad(45.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class MapFrame:
    """``T_map_first``: (4, 4) the first keyframe's optical frame in the map. ``is_floor_known``:
    whether z = 0 is the floor. ``notes``: for people."""

    T_map_first: FloatArray
    is_floor_known: bool
    notes: tuple[str, ...]

    def __post_init__(self) -> None:
        read_only(self.T_map_first)


def level_map_frame(
    views: KeyframeViews, intrinsics: CameraIntrinsics, T_lidar_camera: FloatArray | None
) -> MapFrame:
    """Level the map by the floor below the keyframes, else by the LiDAR's mount, else by the first
    camera's own axes.

    ``views``: with poses in the first keyframe's frame. The map begins below the first camera, or
    at the LiDAR where there is a mount, and its x axis points where that looks.
    """
    T_body_first = make_transform(R_BODY_OPTICAL, np.zeros(3))
    tilt_max_rad = _TILT_MAX_RAD
    if T_lidar_camera is not None:
        T_body_first, tilt_max_rad = T_lidar_camera, float(_TILT_MAX_MOUNTED_RAD)
    try:
        floor = find_floor_in_map(
            ((frame.depth_m, T) for frame, T in views.spread(_IMAGES_SAMPLED)),
            views.depth_intrinsics(intrinsics),
            T_body_first[2, :3],
            tilt_max_rad=float(tilt_max_rad),
        )
    except AlignmentFailed as error:
        return MapFrame(
            T_map_first=T_body_first,
            is_floor_known=False,
            notes=(_without_floor(error.problem, T_lidar_camera is not None),),
        )
    return MapFrame(
        T_map_first=_above_floor(floor, T_body_first),
        is_floor_known=True,
        notes=(
            f"The map's z = 0 is the floor, seen {np.rad2deg(floor.tilt_rad):.1f} degrees off the "
            f"{'mount' if T_lidar_camera is not None else 'first camera'}'s own vertical.",
        ),
    )


def _without_floor(problem: str, is_mounted: bool) -> str:
    axes = "the LiDAR's first pose" if is_mounted else "the first camera's own axes"
    return f"The map's frame is {axes}, and its height is not above the floor: {problem}"


def _above_floor(floor: FloorInMap, T_body_first: FloatArray) -> FloatArray:
    """T_map_first with z along the floor's normal, and x as near to the body's as can be."""
    z = floor.up
    x = T_body_first[0, :3] - (T_body_first[0, :3] @ z) * z
    if np.linalg.norm(x) < 1e-6:
        # The body looks straight down: its y will do.
        x = np.cross(T_body_first[1, :3], z)
    x = x / np.linalg.norm(x)
    R_map_first = np.stack([x, np.cross(z, x), z])
    # The body's origin, in the first camera's frame, lies above the map's.
    origin = -T_body_first[:3, :3].T @ T_body_first[:3, 3]
    shift = -R_map_first @ origin
    shift[2] = floor.offset_m
    return make_transform(R_map_first, shift)
