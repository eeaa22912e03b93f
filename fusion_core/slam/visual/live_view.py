"""What is shown of visual SLAM while it runs: the keyframes, and a few points of each in colour."""

import numpy as np

from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray
from fusion_core.model.geometry import transform_points
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.visual_slam_view import VisualSlamObserver, VisualSlamView, unobserved
from fusion_core.slam.visual.image_trajectory import ImageTrajectory
from fusion_core.slam.visual.pinhole import unproject
from fusion_core.slam.visual.visual_map import VisualMap

# Points of each keyframe that a view shows.
_POINTS_PER_VIEW = 800


class LiveView:
    """Shows a map to an observer whenever it has a new keyframe."""

    def __init__(self, observer: VisualSlamObserver, camera: FloatArray) -> None:
        self._observer, self._camera = observer, camera
        # Of each keyframe.
        self._clouds: list[tuple[Float32Array, ByteArray]] = []

    def show(self, visual_map: VisualMap, trajectory: ImageTrajectory, frame: RgbdFrame) -> None:
        """The map, whose newest keyframe is of ``frame``."""
        if self._observer is unobserved:
            return
        self._clouds.append(sample_cloud(frame, self._camera))
        poses = trajectory.poses(visual_map)
        of_keyframes = np.stack([visual_map.pose_of(k.index) for k in visual_map.keyframes])
        points = [
            transform_points(T, cloud.astype(np.float64))
            for T, (cloud, _) in zip(of_keyframes, self._clouds, strict=True)
        ]
        known = np.isfinite(poses[:, 0, 0])
        self._observer(
            VisualSlamView(
                stage="tracking",
                stamps_ns=np.array(trajectory.stamps_ns, np.int64)[known],
                T_map_camera=poses[known],
                keyframe_stamps_ns=np.array([k.stamp_ns for k in visual_map.keyframes], np.int64),
                T_map_keyframe=of_keyframes,
                loops=np.array(
                    [(loop.first, loop.second) for loop in visual_map.loops], np.int64
                ).reshape(-1, 2),
                points_in_map_m=np.concatenate(points).astype(np.float32),
                rgb=np.concatenate([rgb for _, rgb in self._clouds]),
            )
        )


def sample_cloud(frame: RgbdFrame, camera: FloatArray) -> tuple[Float32Array, ByteArray]:
    """(P, 3) points of an image in its optical frame, evenly over it, and (P, 3) their colours."""
    (height, width), (rows, columns) = frame.gray.shape, frame.depth_m.shape
    step = max(1, int(np.sqrt(rows * columns / _POINTS_PER_VIEW)))
    v, u = np.mgrid[step // 2 : rows : step, step // 2 : columns : step].reshape(2, -1)
    depths_m = frame.depth_m[v, u].astype(np.float64)
    known = np.isfinite(depths_m)
    u, v, depths_m = u[known], v[known], depths_m[known]
    pixels = np.column_stack([(u + 0.5) * width / columns - 0.5, (v + 0.5) * height / rows - 0.5])
    rows_of, columns_of = (np.floor(pixels[:, axis] + 0.5).astype(np.int64) for axis in (1, 0))
    if frame.rgb is None:
        rgb = np.repeat(frame.gray[rows_of, columns_of][:, np.newaxis], 3, axis=1)
    else:
        rgb = frame.rgb[rows_of, columns_of]
    return unproject(pixels, depths_m, camera).astype(np.float32), rgb
