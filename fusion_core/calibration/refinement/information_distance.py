"""Normalised information distance of two kinds of labels, such as a LiDAR's intensity and an
image's grey value at the pixels of its points.

With the entropy H and the mutual information I of the pairs (a, b),
NID = (H(A, B) - I(A; B)) / H(A, B): 0 where each tells the other, 1 where they are independent. It
depends on how the values are grouped alone, and no monotone change of either alters the groups of
equal counts used here. (Pandey et al. 2012 align by I; NID is a metric, Li et al. 2004.)
"""

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import Float32Array, FloatArray, IntArray


@compiled()
def add_pairs(
    points_in_lidar_m: FloatArray,
    labels: IntArray,
    layers: IntArray,
    image: Float32Array,
    pinhole: tuple[float, float, float, float],
    T_camera_lidar: FloatArray,
    joint: FloatArray,
) -> None:
    """Count the pairs (label of a point, group of the image at its pixel) in ``joint``, in place.

    ``labels``: (N,) rows of ``joint``. ``layers``: (N,) which layer of ``image`` (K, H, W) each
    point looks at. The image's values are groups 0 ... G - 1, of which ``joint`` has the columns; a
    value between two counts in both by its distance, so that the result changes smoothly with the
    pose. ``pinhole``: fx, fy, cx, cy. Points behind the camera, outside the image or where it is
    NaN do not count.
    """
    fx, fy, cx, cy = pinhole
    T = T_camera_lidar
    height, width = image.shape[1:]
    groups = joint.shape[1]
    for i in range(points_in_lidar_m.shape[0]):
        p = points_in_lidar_m[i]
        z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
        if z <= 0.0:
            continue
        u = fx * (T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]) / z + cx
        v = fy * (T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]) / z + cy
        if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
            continue
        column, row = int(u), int(v)
        du, dv = u - column, v - row
        layer = image[layers[i]]
        above = layer[row, column] * (1.0 - du) + layer[row, column + 1] * du
        below = layer[row + 1, column] * (1.0 - du) + layer[row + 1, column + 1] * du
        value = above * (1.0 - dv) + below * dv
        if not value >= 0.0:
            continue
        group = min(int(value), groups - 2)
        part = value - group
        joint[labels[i], group] += 1.0 - part
        joint[labels[i], group + 1] += part


def mutual_information(joint: FloatArray) -> float:
    """I(A; B) in nats of counts of pairs (A, B); 0 without pairs."""
    information = joint_information(joint)
    return float((joint * information).sum() / max(joint.sum(), 1e-300))


def joint_information(joint: FloatArray) -> FloatArray:
    """(A, B) the pointwise information log(p(a, b) / (p(a) p(b))); 0 where there is no pair."""
    apart = joint.sum(axis=1, keepdims=True) * joint.sum(axis=0, keepdims=True)
    some = joint > 0.0
    ratio = np.divide(joint * joint.sum(), apart, out=np.ones(joint.shape), where=some)
    return np.asarray(np.log(ratio), dtype=np.float64)


def joint_entropy(joint: FloatArray) -> float:
    """H(A, B) in nats of counts of pairs."""
    p = joint[joint > 0.0] / max(joint.sum(), 1e-300)
    return float(-(p * np.log(p)).sum())


def normalised_information_distance(joint: FloatArray) -> float:
    """NID of counts of pairs: 1 where there is no pair, or one kind alone."""
    entropy = joint_entropy(joint)
    if entropy <= 0.0:
        return 1.0
    return 1.0 - mutual_information(joint) / entropy


def equal_groups(values: FloatArray, groups: int) -> IntArray:
    """(N,) the group of each value among at most ``groups`` of equal counts, by rank."""
    ends = np.unique(np.quantile(values, np.arange(1, groups) / groups))
    found: IntArray = np.searchsorted(ends, values, side="left").astype(np.int64)
    return np.unique(found, return_inverse=True)[1].astype(np.int64)


def group_scale(image: Float32Array, samples: FloatArray, groups: int) -> Float32Array:
    """An image's values as positions 0 ... groups - 1 among equal counts of ``samples`` of it."""
    # Four knots a group: the scale is linear between, and one knot a group would be coarse.
    places = np.linspace(0.0, 1.0, 4 * groups + 1)
    knots = np.quantile(samples, places)
    rising = np.concatenate([[True], np.diff(knots) > 0.0])
    # Values that many samples share are one place, in the middle of theirs.
    middle = np.array([places[knots == knot].mean() for knot in knots[rising]])
    scaled = np.interp(image, knots[rising], middle * (groups - 1))
    return np.asarray(scaled, dtype=np.float32)
