"""Concave corners, in which light takes a second way from wall to wall before it returns."""

import cv2
import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray

# Two surfaces make a corner if they are at least 30° from parallel ...
_PARALLEL_COS = np.cos(np.radians(30.0))
# ... and touch: two samples next to each other lie no farther apart, whatever the range.
_TOUCHING_M = 0.1


def corner_distance_in_sweep(
    points_m: FloatArray, normals: FloatArray, bright: BoolArray
) -> FloatArray:
    """(N,) distance from where each beam ends to the nearest concave corner beside it, in metres.

    ``points_m``, ``normals``: (N, 3), normals towards the sensor. ``bright``: (N,); only bright
    surfaces pass light on. inf where there is no corner.
    """
    crease = np.zeros(len(points_m), dtype=np.bool_)
    crease[:-1] = _is_corner(points_m[:-1], points_m[1:], normals[:-1], normals[1:])
    crease[:-1] &= bright[:-1] & bright[1:]
    at = np.flatnonzero(crease)
    distance_m = np.full(len(points_m), np.inf)
    if at.size == 0:
        return distance_m
    corners_m = 0.5 * (points_m[at] + points_m[at + 1])
    beams = np.arange(len(points_m))
    after = np.searchsorted(at, beams)
    for near in (np.maximum(after - 1, 0), np.minimum(after, at.size - 1)):
        apart_m = np.linalg.norm(points_m - corners_m[near], axis=1)
        distance_m = np.minimum(distance_m, apart_m)
    return np.where(bright, distance_m, np.inf)


def corner_distance_in_image(
    points_m: FloatArray, normals: FloatArray, bright: BoolArray
) -> FloatArray:
    """(H, W) the same of an image: ``points_m``, ``normals``: (H, W, 3), ``bright``: (H, W).

    The corner is the one nearest in the image.
    """
    crease = np.zeros(bright.shape, dtype=np.bool_)
    for before, after in (
        (np.s_[:, :-1], np.s_[:, 1:]),
        (np.s_[:-1], np.s_[1:]),
    ):
        touching = _is_corner(points_m[before], points_m[after], normals[before], normals[after])
        crease[before] |= touching & bright[before] & bright[after]
    if not crease.any():
        return np.full(bright.shape, np.inf)
    _, labels = cv2.distanceTransformWithLabels(
        (~crease).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    pixel_of_label: IntArray = np.zeros(int(labels.max()) + 1, dtype=np.int64)
    pixel_of_label[labels[crease]] = np.flatnonzero(crease)
    corners_m = points_m.reshape(-1, 3)[pixel_of_label[labels]]
    apart_m = points_m - corners_m
    return np.where(bright, np.sqrt(_dot(apart_m, apart_m)), np.inf)


def _is_corner(
    points_a: FloatArray, points_b: FloatArray, normals_a: FloatArray, normals_b: FloatArray
) -> BoolArray:
    """(...): whether two neighbouring points (..., 3) lie on the two sides of a concave corner."""
    corner: BoolArray = np.abs(_dot(normals_a, normals_b)) < _PARALLEL_COS
    # Few neighbours lie on different planes.
    first_m, second_m = points_a[corner], points_b[corner]
    apart_m = second_m - first_m
    # Each lies in front of the other's surface.
    concave = (_dot(apart_m, normals_a[corner]) > 0.0) & (_dot(apart_m, normals_b[corner]) < 0.0)
    corner[corner] = concave & (_dot(apart_m, apart_m) < _TOUCHING_M**2)
    return corner


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    product: FloatArray = np.einsum("...i,...i->...", a, b)
    return product
