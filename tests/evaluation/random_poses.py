"""Trajectories that wander in space, from a seed."""

import numpy as np
from scipy.spatial.transform import Rotation

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.trajectory import Trajectory


def random_transforms(count: int, seed: int, spread_m: float = 3.0) -> FloatArray:
    """(count, 4, 4) poses anywhere, turned by up to half a turn."""
    random = np.random.default_rng(seed)
    result = np.tile(np.eye(4), (count, 1, 1))
    result[:, :3, :3] = Rotation.from_rotvec(random.uniform(-1.7, 1.7, (count, 3))).as_matrix()
    result[:, :3, 3] = random.uniform(-spread_m, spread_m, (count, 3))
    return result


def random_walk(stamps_ns: IntArray, seed: int) -> Trajectory:
    """Poses that follow from one another by random steps of decimetres and tenths of a radian."""
    random = np.random.default_rng(seed)
    pose = np.eye(4)
    poses = []
    for step_m, turn_rad in zip(
        random.normal(0.0, 0.1, (stamps_ns.size, 3)),
        random.normal(0.0, 0.1, (stamps_ns.size, 3)),
        strict=True,
    ):
        step = np.eye(4)
        step[:3, :3] = Rotation.from_rotvec(turn_rad).as_matrix()
        step[:3, 3] = step_m
        pose = pose @ step
        poses.append(pose)
    return Trajectory(stamps_ns=stamps_ns, T_map_body=np.array(poses))
