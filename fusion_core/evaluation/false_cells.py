"""Cells that a map calls free or occupied and that are not, by the true ranges of the LiDAR.

A free cell is false where no true ray of any scan reaches its middle: it holds an obstacle, or lies
behind a surface from everywhere the robot was. An occupied cell is false where no true surface
lies within one cell and 2 cm of its middle, the tolerance of detection rates.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from fusion_core.evaluation.associated_truth import beam_angles_rad
from fusion_core.evaluation.fuse_folder import FuseFolder
from fusion_core.evaluation.map_measures import MapCells
from fusion_core.evaluation.map_outlines import TOLERANCE_M
from fusion_core.evaluation.truth import Truth
from fusion_core.model.conventions import BoolArray, FloatArray, read_only
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.planar_poses import transform_planar_points
from fusion_core.model.polar import beams_towards, points_from_polar


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrueViews:
    """Scans without noise: ``pose`` (S, 3) x, y, yaw in the world, ``azimuth_rad`` (N,) of the
    beams, evenly spaced, and ``range_m`` (S, N), NaN where there is none."""

    pose: FloatArray
    azimuth_rad: FloatArray
    range_m: FloatArray

    def __post_init__(self) -> None:
        for array in (self.pose, self.azimuth_rad, self.range_m):
            read_only(array)

    def surface_m(self) -> FloatArray:
        """(K, 2) the points that the beams meet, in the world."""
        points = [
            transform_planar_points(pose, points_from_polar(range_m, self.azimuth_rad))
            for pose, range_m in zip(self.pose, self.range_m, strict=True)
        ]
        ends_m = np.concatenate([np.empty((0, 2)), *points])
        known: FloatArray = ends_m[np.isfinite(ends_m).all(axis=1)]
        return known

    def reaches(self, points_m: FloatArray) -> BoolArray:
        """(M,): whether the beam towards any of (M, 2) points passes it in any scan."""
        reached = np.zeros(len(points_m), dtype=np.bool_)
        first_rad, second_rad = (float(azimuth) for azimuth in self.azimuth_rad[:2])
        for pose, range_m in zip(self.pose, self.range_m, strict=True):
            # A point that was reached once need not be looked at again.
            left = np.flatnonzero(~reached)
            x_m, y_m = (points_m[left] - pose[:2]).T
            towards_rad = np.arctan2(y_m, x_m) - pose[2]
            beam = beams_towards(towards_rad, first_rad, second_rad - first_rad, range_m.size)
            ahead_m = np.where(beam >= 0, range_m[beam], np.nan)
            reached[left] = ahead_m > np.hypot(x_m, y_m)
        return reached


@dataclass(frozen=True, slots=True, kw_only=True)
class FalseCells:
    """Numbers of free and occupied cells, and of those among them that are false."""

    free: int
    false_free: int
    occupied: int
    false_occupied: int

    def to_json(self) -> dict[str, Any]:
        """The numbers, and the fractions of all cells of the kind."""
        return {
            "free": self.free,
            "false_free": self.false_free,
            "false_free_fraction": self.false_free / self.free if self.free else None,
            "occupied": self.occupied,
            "false_occupied": self.false_occupied,
            "false_occupied_fraction": (
                self.false_occupied / self.occupied if self.occupied else None
            ),
        }


def true_views(truth: Truth, folder: FuseFolder) -> TrueViews:
    """The views of a truth. Angles that it lacks are the recorded ones.

    Raises ScanLoomError where it has no poses, or is of another recording.
    """
    if truth.pose is None:
        raise ScanLoomError(
            "has no array 'pose'.", file=truth.file, advice="Give a truth with the LiDAR's poses."
        )
    return TrueViews(
        pose=truth.pose, azimuth_rad=beam_angles_rad(truth, folder), range_m=truth.range_m
    )


def evaluate_false_cells(cells: MapCells, views: TrueViews) -> FalseCells:
    """Compare a map's cells, in the world's frame, with what the LiDAR truly met."""
    from scipy.spatial import cKDTree

    nearest_m, _ = cKDTree(views.surface_m()).query(cells.occupied_m.reshape(-1, 2))
    false_occupied = np.asarray(nearest_m) > cells.resolution_m + TOLERANCE_M
    return FalseCells(
        free=len(cells.free_m),
        false_free=int((~views.reaches(cells.free_m)).sum()),
        occupied=len(cells.occupied_m),
        false_occupied=int(false_occupied.sum()),
    )
