"""Up, by the directions of the surfaces that a depth camera sees.

Gupta, Arbelaez and Malik, Perceptual organization and recognition of indoor scenes, CVPR 2013: up
is the direction that normals of the floor are parallel to, and those of walls perpendicular. Which
normals are which is told from the direction found so far, within a cone that narrows.
"""

import numpy as np

from fusion_core.model.conventions import FloatArray

# Half the angle of the cones, and how often up is found with each, as in the paper.
_CONES_RAD = np.deg2rad([45.0, 15.0])
_ITERATIONS = 5
# Up stays where it was about an axis that fewer than one in so many normals show: those of a single
# wall say nothing of a turn about them.
_LEAST_SHOWN = 1.0 / 50.0


def find_up(normals: FloatArray, up_start: FloatArray) -> FloatArray:
    """(3,) up in the frame of (N, 3) unit normals that point to the camera, near ``up_start``."""
    up = up_start
    for cone_rad in _CONES_RAD:
        for _ in range(_ITERATIONS):
            along = normals @ up
            level = normals[along > np.cos(cone_rad)]
            upright = normals[np.abs(along) < np.sin(cone_rad)]
            held = _LEAST_SHOWN * max(1, len(level) + len(upright))
            spread = upright.T @ upright - level.T @ level - held * np.outer(up_start, up_start)
            # Of the least eigenvalue, the first.
            least = np.linalg.eigh(spread).eigenvectors[:, 0]
            up = least if least @ up_start > 0.0 else -least
    return up
