"""How far the relation of two keyframes can be off by the odometry between them.

Drift is declared, as a part of the path, and not read from the adjustment's own covariance, which
knows of nothing but pixel noise. It is taken to grow with the path's length, not with its root: an
error of the depth scale or of the lens turns all steps alike.
"""

from collections.abc import Sequence

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.geometry import invert_transform
from fusion_core.settings import StageSettings, setting

# 0.999 quantile of chi-square with six degrees of freedom.
GATE_CHI2 = 22.46


class DriftSettings(StageSettings):
    """The drift that is taken to be possible; two standard deviations hold most cameras."""

    translation_m_per_m: float = setting(
        0.015, "Standard deviation of the position over the path's length", ge=1e-6, le=1.0
    )
    rotation_rad_per_m: float = setting(
        0.005,
        "Standard deviation of the orientation over the path's length",
        unit="rad/m",
        ge=1e-6,
        le=1.0,
    )
    turn_m_per_rad: float = setting(
        1.0,
        "Length of a path on the spot, per angle turned: a turn moves the image as a shift does",
        unit="m/rad",
        ge=0.0,
        le=100.0,
    )


def step_lengths_m(
    T_map_first: FloatArray, T_map_second: FloatArray, settings: DriftSettings
) -> FloatArray:
    """(N,) lengths of steps between (N, 4, 4) poses, with what they turn."""
    away_m = np.linalg.norm(T_map_second[:, :3, 3] - T_map_first[:, :3, 3], axis=1)
    trace = np.einsum("nij,nij->n", T_map_first[:, :3, :3], T_map_second[:, :3, :3])
    turned_rad = np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))
    lengths_m: FloatArray = away_m + settings.turn_m_per_rad * turned_rad
    return lengths_m


def drift_covariance(
    T_map_node: FloatArray, settings: DriftSettings, path_m: float | None = None
) -> FloatArray:
    """(6, 6) of the last pose of a path in the first one's frame, by the drift of each step.

    ``T_map_node``: (N, 4, 4) along the path. The covariance is of a small motion of the last in its
    own frame, rotation first. A step of length s on a path of length S has the variance
    rate² s S, so that the standard deviation of all is rate S. ``path_m``: S, where this is a part
    of a longer path.
    """
    steps_m = step_lengths_m(T_map_node[:-1], T_map_node[1:], settings)
    rates = np.repeat([settings.rotation_rad_per_m, settings.translation_m_per_m], 3)
    T_last_map = invert_transform(T_map_node[-1])
    moved = adjoints(T_last_map @ T_map_node[1:])
    weights = steps_m * (float(steps_m.sum()) if path_m is None else path_m)
    covariance: FloatArray = np.einsum("n,nij,j,nkj->ik", weights, moved, rates**2, moved)
    return covariance


def small_motion_between(T_a: FloatArray, T_b: FloatArray) -> FloatArray:
    """(6,) the motion of a in its own frame that makes it b: rotation vector, translation."""
    from scipy.spatial.transform import Rotation

    T_a_b = invert_transform(T_a) @ T_b
    return np.concatenate([Rotation.from_matrix(T_a_b[:3, :3]).as_rotvec(), T_a_b[:3, 3]])


def shortest_path(
    T_map_node: FloatArray,
    pairs: Sequence[tuple[int, int]],
    first: int,
    second: int,
    settings: DriftSettings,
) -> list[int] | None:
    """The nodes from the first to the second with the least drift; None where nothing connects
    them. ``pairs``: what is connected."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    if not pairs:
        return None
    ends = np.array(sorted({(min(pair), max(pair)) for pair in pairs}), dtype=np.int64)
    lengths_m = step_lengths_m(T_map_node[ends[:, 0]], T_map_node[ends[:, 1]], settings)
    # An entry of zero would be no edge in the sparse matrix.
    lengths_m = np.maximum(lengths_m, 1e-6)
    count = len(T_map_node)
    graph = csr_array((lengths_m, (ends[:, 0], ends[:, 1])), shape=(count, count))
    distances_m, befores = dijkstra(
        graph, directed=False, indices=np.array([first]), return_predecessors=True
    )
    if not np.isfinite(distances_m[0, second]):
        return None
    path = [second]
    while path[-1] != first:
        path.append(int(befores[0, path[-1]]))
    return path[::-1]


def path_length_m(T_map_node: FloatArray, settings: DriftSettings) -> float:
    """Of (N, 4, 4) poses along a path, with what they turn."""
    return float(step_lengths_m(T_map_node[:-1], T_map_node[1:], settings).sum())


def adjoints(T_a_b: FloatArray) -> FloatArray:
    """(N, 6, 6) of (N, 4, 4): a small motion in b's frame, rotation first, as one in a's."""
    R, t = T_a_b[:, :3, :3], T_a_b[:, :3, 3]
    result = np.zeros((len(R), 6, 6))
    result[:, :3, :3] = result[:, 3:, 3:] = R
    zero = np.zeros(len(R))
    x, y, z = t.T
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)
    result[:, 3:, :3] = skew @ R
    return result
