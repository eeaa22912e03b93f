"""Arrays of rigid transforms (N, 4, 4): inverses, differences, projection and interpolation.

``Trajectory.at`` interpolates at one instant; here all instants are done at once.
"""

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray
from fusion_core.model.trajectory import Trajectory


def invert_poses(T_a_b: FloatArray) -> FloatArray:
    """(N, 4, 4) T_b_a."""
    rotations = np.swapaxes(T_a_b[:, :3, :3], 1, 2)
    result = np.tile(np.eye(4), (len(T_a_b), 1, 1))
    result[:, :3, :3] = rotations
    result[:, :3, 3] = -np.einsum("nij,nj->ni", rotations, T_a_b[:, :3, 3])
    return result


def relative_poses(T_map_a: FloatArray, T_map_b: FloatArray) -> FloatArray:
    """(N, 4, 4) T_a_b."""
    rotations = np.swapaxes(T_map_a[:, :3, :3], 1, 2)
    result = np.tile(np.eye(4), (len(T_map_a), 1, 1))
    result[:, :3, :3] = rotations @ T_map_b[:, :3, :3]
    # From the difference, which keeps the digits of positions far from the map's origin.
    step_m = T_map_b[:, :3, 3] - T_map_a[:, :3, 3]
    result[:, :3, 3] = np.einsum("nij,nj->ni", rotations, step_m)
    return result


def translation_norms_m(T_a_b: FloatArray) -> FloatArray:
    """(N,) length of each translation."""
    return np.asarray(np.linalg.norm(T_a_b[:, :3, 3], axis=1))


def rotation_angles_rad(T_a_b: FloatArray) -> FloatArray:
    """(N,) angle of each rotation, in [0, pi]."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(T_a_b[:, :3, :3]).magnitude())


def project_to_plane(T_map_body: FloatArray) -> FloatArray:
    """(N, 4, 4) with x, y and yaw only; height, pitch and roll are dropped."""
    from scipy.spatial.transform import Rotation

    yaw_rad = np.arctan2(T_map_body[:, 1, 0], T_map_body[:, 0, 0])
    result = np.tile(np.eye(4), (len(T_map_body), 1, 1))
    result[:, :3, :3] = Rotation.from_euler("z", yaw_rad[:, np.newaxis]).as_matrix()
    result[:, :2, 3] = T_map_body[:, :2, 3]
    return result


def interpolate_poses(
    trajectory: Trajectory, stamps_ns: IntArray, max_gap_ns: int | None = None
) -> tuple[FloatArray, BoolArray]:
    """Poses at (N,) instants in any order: (K, 4, 4) of the known ones, and (N,) which are known.

    Between the two neighbours in time the position is interpolated linearly, the rotation along the
    shorter arc. Unknown are instants outside the trajectory, or between neighbours farther apart
    than ``max_gap_ns``; an instant that has a pose of its own is always known.
    """
    own_ns = trajectory.stamps_ns
    known: BoolArray = (stamps_ns >= own_ns[0]) & (stamps_ns <= own_ns[-1])
    query_ns = stamps_ns[known]
    after = np.searchsorted(own_ns, query_ns)
    before = np.where(own_ns[after] == query_ns, after, after - 1)
    gap_ns = own_ns[after] - own_ns[before]
    if max_gap_ns is not None:
        near = gap_ns <= max_gap_ns
        known[known] = near
        query_ns, before, after, gap_ns = (a[near] for a in (query_ns, before, after, gap_ns))
    fraction = (query_ns - own_ns[before]) / np.maximum(gap_ns, 1)
    return _interpolate_between(
        trajectory.T_map_body[before], trajectory.T_map_body[after], fraction
    ), known


def _interpolate_between(
    T_before: FloatArray, T_after: FloatArray, fraction: FloatArray
) -> FloatArray:
    from scipy.spatial.transform import Rotation

    result = T_before.copy()
    step_m = T_after[:, :3, 3] - T_before[:, :3, 3]
    result[:, :3, 3] += fraction[:, np.newaxis] * step_m
    rotation_vector = Rotation.from_matrix(relative_poses(T_before, T_after)[:, :3, :3]).as_rotvec()
    part = Rotation.from_rotvec(fraction[:, np.newaxis] * rotation_vector).as_matrix()
    result[:, :3, :3] = T_before[:, :3, :3] @ part
    return result
