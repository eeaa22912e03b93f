"""The three directions of a box-shaped room, from a cloud of its surfaces."""

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray

_NEIGHBOURS = 30
# A neighbourhood is a surface where it is this much thinner than wide (as standard deviations).
_THICKNESS_MAX = 0.5
_NEAR_DEG = 20.0
# Directions that are tried as the first axis: enough that one lies within a degree of each wall's.
_CANDIDATES = 400
_ROUNDS = 20


def surface_normals(points_m: FloatArray) -> tuple[FloatArray, BoolArray]:
    """(N, 3) unit normals of the neighbourhoods of (N, 3) points, of either sign, and which of
    them are surfaces."""
    from scipy.spatial import cKDTree

    count = min(_NEIGHBOURS, len(points_m))
    _, found = cKDTree(points_m).query(points_m, count)
    neighbours = np.asarray(found)
    normals = np.empty_like(points_m)
    is_surface = np.empty(len(points_m), np.bool_)
    # In blocks: 30 neighbours of a million points are 700 MB.
    for start in range(0, len(points_m), 1 << 16):
        block = points_m[neighbours[start : start + (1 << 16)].reshape(-1, count)]
        centred_m = block - block.mean(axis=1, keepdims=True)
        values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", centred_m, centred_m))
        end = start + len(block)
        normals[start:end] = vectors[:, :, 0]
        is_surface[start:end] = values[:, 0] <= _THICKNESS_MAX**2 * values[:, 1]
    return normals, is_surface


def box_axes(normals: FloatArray) -> FloatArray | None:
    """(3, 3) right-handed rotation whose columns are the directions that most of (N, 3) unit
    normals have, up to their sign, at right angles to each other. None without such directions.

    The first column has the most normals near it, the second the most of those across it. All are
    then fitted together: each is the main direction of the normals near it, and the nearest
    rotation to the three is taken, until they stay.
    """
    if len(normals) == 0:
        return None
    near = np.cos(np.deg2rad(_NEAR_DEG))
    candidates = normals[:: max(1, len(normals) // _CANDIDATES)]
    first = candidates[np.argmax((np.abs(candidates @ normals.T) > near).sum(axis=1))]
    across = candidates - np.outer(candidates @ first, first)
    lengths = np.linalg.norm(across, axis=1)
    across = across[lengths > near] / lengths[lengths > near, np.newaxis]
    if len(across) == 0:
        return None
    third = np.cross(first, across)
    # Both of the other two axes count: of a room one wall may be hidden.
    support = (np.abs(across @ normals.T) > near).sum(axis=1)
    support += (np.abs(third @ normals.T) > near).sum(axis=1)
    second = across[np.argmax(support)]
    axes = np.stack([first, second, np.cross(first, second)], axis=1)
    for _ in range(_ROUNDS):
        before, axes = axes, _refined(axes, normals, near)
        if np.abs(axes - before).max() < 1e-9:
            break
    return axes


def _refined(axes: FloatArray, normals: FloatArray, near: float) -> FloatArray:
    cosines = normals @ axes
    found = axes.copy()
    for axis in range(3):
        own = normals[np.abs(cosines[:, axis]) > near]
        if len(own):
            _, vectors = np.linalg.eigh(own.T @ own)
            direction = vectors[:, 2]
            found[:, axis] = direction if direction @ axes[:, axis] > 0.0 else -direction
    u, _, vt = np.linalg.svd(found)
    return np.asarray(u @ vt, dtype=np.float64)
