"""The files of a run of visual SLAM: trajectories, keyframes, and the map of landmarks."""

from pathlib import Path

import numpy as np

from fusion_core.exporting.tum_trajectory import write_tum_trajectory
from fusion_core.files.npz import write_arrays
from fusion_core.model.conventions import FloatArray
from fusion_core.model.geometry import invert_transform, transform_points
from fusion_core.model.trajectory import Trajectory
from fusion_core.slam.visual.keyframes import NO_LANDMARK
from fusion_core.slam.visual.visual_map import VisualMap
from fusion_core.slam.visual.visual_slam import VisualSlamResult


def write_trajectories(
    folder: Path,
    result: VisualSlamResult,
    T_map_first: FloatArray,
    T_lidar_camera: FloatArray | None,
) -> None:
    """``trajectory.tum`` of the images that have a pose, and ``keyframes.tum``.

    The trajectory is the camera's; where there is a LiDAR it is the LiDAR's, and the camera's is
    ``trajectory_camera.tum``. ``T_map_first``: (4, 4) see ``MapFrame``.
    """
    tracked = result.is_tracked
    stamps_ns, poses = result.stamps_ns[tracked], T_map_first @ result.T_map_camera[tracked]
    camera = Trajectory(stamps_ns=stamps_ns, T_map_body=poses)
    if T_lidar_camera is None:
        write_tum_trajectory(folder / "trajectory.tum", camera)
    else:
        lidar = poses @ invert_transform(T_lidar_camera)
        write_tum_trajectory(
            folder / "trajectory.tum", Trajectory(stamps_ns=stamps_ns, T_map_body=lidar)
        )
        write_tum_trajectory(folder / "trajectory_camera.tum", camera)
    keyframes = result.visual_map.kept_keyframes
    write_tum_trajectory(
        folder / "keyframes.tum",
        Trajectory(
            stamps_ns=np.array([keyframe.stamp_ns for keyframe in keyframes], np.int64),
            T_map_body=T_map_first @ np.stack([keyframe.T_map_camera for keyframe in keyframes]),
        ),
    )


def write_visual_map(file: Path, visual_map: VisualMap, T_map_first: FloatArray) -> None:
    """The keyframes that are kept, with the pixels of their features and the landmarks that these
    see, numbered anew without the culled ones."""
    keyframes = visual_map.kept_keyframes
    kept = np.flatnonzero(~visual_map.is_landmark_culled)
    renumbered = np.full(len(visual_map.is_landmark_culled) + 1, NO_LANDMARK, np.int64)
    renumbered[kept] = np.arange(len(kept))
    place = {keyframe.index: number for number, keyframe in enumerate(keyframes)}
    loops = [loop for loop in visual_map.loops if loop.first in place and loop.second in place]
    counts = [len(keyframe.features) for keyframe in keyframes]
    arrays = {
        "stamps_ns": np.array([keyframe.stamp_ns for keyframe in keyframes], np.int64),
        "T_map_camera": T_map_first @ np.stack([keyframe.T_map_camera for keyframe in keyframes]),
        "offsets": np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        "pixels": np.concatenate([keyframe.features.pixels for keyframe in keyframes]).astype(
            np.float32
        ),
        # NO_LANDMARK takes the last place, which holds NO_LANDMARK.
        "landmarks": renumbered[np.concatenate([keyframe.landmarks for keyframe in keyframes])],
        "landmarks_in_map_m": transform_points(T_map_first, visual_map.positions_in_map_m[kept]),
        "loops": np.array(
            [(place[loop.first], place[loop.second]) for loop in loops], np.int64
        ).reshape(-1, 2),
        "loop_inliers": np.array([len(loop.pose.matches) for loop in loops], np.int64),
    }
    write_arrays(file, arrays)
