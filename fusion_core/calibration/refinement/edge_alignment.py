"""Image edges for the steps of a LiDAR's depth: a field of each direction, blurred for the search.

Levinson & Thrun 2013 sum an image's edges under a cloud's depth steps. Here the evidence is the
mutual information of "the surface ends here" and the image's gradient across that place, so that a
scene in which edges say little gives them little weight. Only the gradient towards the neighbouring
beam counts: the side of a pole is a vertical edge, the top of a wall a horizontal one.
"""

import cv2
import numpy as np

from fusion_core.model.conventions import Float32Array, FloatArray, IntArray

ORIENTATIONS = 4
"""Fields: gradients along 0, 45, 90 and 135 degrees from the image's u axis."""
# Gradients count up to so many times the mean of their surroundings.
_CLIP = 5.0
# Grey levels a pixel that are no edge in any image of 8 bits.
_FLOOR = 0.5


def gradient_fields(grey: Float32Array, *, surroundings_px: float) -> Float32Array:
    """(ORIENTATIONS, H, W) absolute gradients, relative to the mean of the surroundings, so that
    an edge in the shade counts as much as one in the sun."""
    smooth = blurred(grey, 1.0)
    along_u = cv2.Scharr(smooth, cv2.CV_32F, 1, 0, scale=1.0 / 32.0)
    along_v = cv2.Scharr(smooth, cv2.CV_32F, 0, 1, scale=1.0 / 32.0)
    width = 2 * round(surroundings_px) + 1
    mean = cv2.boxFilter(
        np.hypot(along_u, along_v), -1, (width, width), borderType=cv2.BORDER_REFLECT
    )
    fields = np.empty((ORIENTATIONS, *grey.shape), dtype=np.float32)
    for number, angle in enumerate(np.pi * np.arange(ORIENTATIONS) / ORIENTATIONS):
        gradient = np.cos(angle) * along_u + np.sin(angle) * along_v
        fields[number] = np.minimum(np.abs(gradient) / (mean + _FLOOR), _CLIP)
    return fields


def orientation_of(directions_px: FloatArray) -> IntArray:
    """(N,) the field whose gradients run nearest along (N, 2) directions in the image."""
    angle = np.arctan2(directions_px[:, 1], directions_px[:, 0])
    number = np.round(angle * ORIENTATIONS / np.pi).astype(np.int64)
    return np.mod(number, ORIENTATIONS)


def grey_contrast(grey: Float32Array, *, surroundings_px: float) -> Float32Array:
    """How far each pixel lies above the mean of its surroundings, in their standard deviations:
    the counterpart of ``intensity_contrast``, to which light and shade are no brightness."""
    width = 2 * round(surroundings_px) + 1
    size = (width, width)
    mean = cv2.boxFilter(grey, -1, size, borderType=cv2.BORDER_REFLECT)
    square = cv2.boxFilter(grey * grey, -1, size, borderType=cv2.BORDER_REFLECT)
    deviation = np.sqrt(np.maximum(square - mean * mean, 0.0))
    # Two grey levels are the noise of a camera of 8 bits.
    return np.asarray((grey - mean) / (deviation + np.float32(2.0)), dtype=np.float32)


def blurred(field: Float32Array, sigma_px: float) -> Float32Array:
    """A field smoothed by a Gaussian: from farther away, the way to an edge is still seen."""
    if sigma_px <= 0.0:
        return field
    return np.asarray(cv2.GaussianBlur(field, (0, 0), sigma_px), dtype=np.float32)
