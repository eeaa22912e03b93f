"""What a run of visual SLAM has found so far or in the end, as the scene draws it."""

from dataclasses import dataclass, fields

import numpy as np

from fusion_core.model.conventions import (
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
    read_only,
)
from fusion_core.model.visual_slam_view import VisualSlamView
from fusion_core.workflows.map.visual_result_folder import T_BODY_CAMERA, VisualResults

# The first keyframe stays where it is but for rounding.
_FIRST_POSE_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VisualPicture:
    """Everything is in the map, z up.

    ``path_m``: (N, 3) of the camera. ``T_map_keyframe``: (K, 4, 4) of optical frames.
    ``loops``: (L, 2) keyframes. ``points_m``: (P, 3) with ``rgb``: (P, 3). ``now``: (4, 4), where
    the camera is, None where nothing tells. ``is_lost``: whether tracking has lost the camera.
    """

    path_m: Float32Array
    T_map_keyframe: FloatArray
    loops: IntArray
    points_m: Float32Array
    rgb: ByteArray
    now: FloatArray | None = None
    is_lost: bool = False

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                read_only(value)


def picture_of_view(view: VisualSlamView) -> VisualPicture:
    """A run while it works. A map that still has the optical axes of its first image is turned to
    its body axes, so that up is about up."""
    poses, keyframes, points_m = view.T_map_camera, view.T_map_keyframe, view.points_in_map_m
    if len(keyframes) and np.allclose(keyframes[0], np.eye(4), atol=_FIRST_POSE_TOLERANCE):
        poses, keyframes = T_BODY_CAMERA @ poses, T_BODY_CAMERA @ keyframes
        points_m = points_m @ T_BODY_CAMERA[:3, :3].T.astype(np.float32)
    placed = np.isfinite(poses).all(axis=(1, 2))
    return VisualPicture(
        path_m=poses[:, :3, 3].astype(np.float32),
        T_map_keyframe=keyframes,
        loops=view.loops,
        points_m=points_m,
        rgb=view.rgb,
        now=poses[placed][-1] if placed.any() else None,
        is_lost=view.is_lost,
    )


def picture_of_results(
    results: VisualResults, points_m: Float32Array, rgb: ByteArray
) -> VisualPicture:
    """A finished run with its cloud, (P, 3) points and colours; where that is empty the landmarks
    take its place, in grey."""
    if not len(points_m):
        known = np.isfinite(results.landmarks_in_map_m).all(axis=1)
        points_m = results.landmarks_in_map_m[known].astype(np.float32)
        rgb = np.full(points_m.shape, 128, dtype=np.uint8)
    return VisualPicture(
        path_m=results.trajectory.T_map_body[:, :3, 3].astype(np.float32),
        T_map_keyframe=results.T_map_camera,
        loops=results.loops,
        points_m=points_m,
        rgb=rgb,
    )
