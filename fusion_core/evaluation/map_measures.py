"""Lengths and angles measured in a map, and their errors: Table 4 of Li 2022.

The paper measures by hand. Here a line is fitted to the occupied cells near each face, and lengths
and angles are taken between the lines. Of a wall that is several cells thick only the cells that
border on free space are used: noisy returns behind a wall are never cleared, so its back is
unreliable. The paper's relative error of lines is the sum of the absolute errors over the sum of
the lengths; its maps show every line, so what a map without one of them scores is not defined.
Here the error is that of the lines found, and how many were not found is stated beside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.world_outline import MeasuredAngle, MeasuredLine, WorldOutline

BAND_M = 0.15
"""Cells nearer than this to a face's true line are taken as cells of the face."""

# Left out at both ends of a face: cells there may belong to an adjoining face.
_END_M = 0.1
_END_FRACTION = 0.2
# Two more than a line needs, so that there is a residual.
_CELLS_MIN = 4
# Cells along less than this fraction of a face do not determine its direction.
_SPAN_FRACTION_MIN = 0.3
# A bound: the loop ends once the direction is stationary.
_ITERATIONS = 30
# A face's free side is the one with more free cells within this distance.
_SIDE_M = 0.3
# A point in free space has the middle of a free cell within 0.71 cells, at any rotation of the map.
_NEXT_CELLS = 0.75


@dataclass(frozen=True, slots=True)
class Measurement:
    """A true value and the one measured in the map, NaN where the map shows too little of it."""

    name: str
    true: float
    value: float

    @property
    def error(self) -> float:
        return self.value - self.true

    def to_json(self, unit: str) -> dict[str, Any]:
        """True value, measured value and error; null where not measured."""
        missing = not np.isfinite(self.value)
        return {
            "name": self.name,
            f"true_{unit}": self.true,
            f"measured_{unit}": None if missing else self.value,
            f"error_{unit}": None if missing else self.error,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureReport:
    """``lines`` in metres, ``angles`` in degrees."""

    lines: tuple[Measurement, ...]
    angles: tuple[Measurement, ...]

    def to_json(self) -> dict[str, Any]:
        """Each line and angle, and the means over those that the map shows.

        ``measured`` of ``total`` are shown; ``missed`` names the others. Their errors are unknown,
        so that means are to be read together with how many were missed.
        """
        lines = [line for line in self.lines if np.isfinite(line.value)]
        angles = [angle for angle in self.angles if np.isfinite(angle.value)]
        errors_m = [abs(line.error) for line in lines]
        true_m = [line.true for line in lines]
        return {
            "lines": {
                **_count_measured(self.lines),
                "mean_absolute_error_m": _mean(errors_m),
                "relative_error": sum(errors_m) / sum(true_m) if lines else None,
                "each": [line.to_json("m") for line in self.lines],
            },
            "angles": {
                **_count_measured(self.angles),
                "mean_absolute_error_deg": _mean([abs(angle.error) for angle in angles]),
                "each": [angle.to_json("deg") for angle in self.angles],
            },
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapCells:
    """Middles of a map's occupied (N, 2) and free (M, 2) cells in the world's frame."""

    occupied_m: FloatArray
    free_m: FloatArray
    resolution_m: float

    @property
    def mapped_m2(self) -> float:
        """The area of all of them."""
        return (len(self.occupied_m) + len(self.free_m)) * self.resolution_m**2


def evaluate_measures(cells: MapCells, world: WorldOutline) -> MeasureReport:
    """Measure the world's lines and angles in a map."""
    return MeasureReport(
        lines=tuple(_measure_length(line, cells) for line in world.lines),
        angles=tuple(_measure_angle(angle, cells) for angle in world.angles),
    )


def _measure_length(line: MeasuredLine, cells: MapCells) -> Measurement:
    fits = [fit_face(face, cells) for face in line.faces_m]
    first, second = fits
    if first is None or second is None:
        return Measurement(line.name, line.length_m, float("nan"))
    # The distance across, perpendicular to either face. The direction of the longer one is better
    # determined, so that its distance weighs more.
    between = second[0] - first[0]
    distances_m = [abs(float(d[0] * between[1] - d[1] * between[0])) for _, d in (first, second)]
    lengths_m = np.linalg.norm(line.faces_m[:, 1] - line.faces_m[:, 0], axis=1)
    weights = lengths_m**2 / (lengths_m**2).sum()
    return Measurement(line.name, line.length_m, float(weights @ distances_m))


def _measure_angle(angle: MeasuredAngle, cells: MapCells) -> Measurement:
    true_deg = float(np.degrees(angle.angle_rad))
    fits = [fit_face(arm, cells) for arm in angle.arms_m]
    first, second = fits
    if first is None or second is None:
        return Measurement(angle.name, true_deg, float("nan"))
    cosine = float(np.clip(first[1] @ second[1], -1.0, 1.0))
    return Measurement(angle.name, true_deg, float(np.degrees(np.arccos(cosine))))


def fit_face(face_m: FloatArray, cells: MapCells) -> tuple[FloatArray, FloatArray] | None:
    """A point (2,) and the unit direction (2,) of the line through the cells of a face (2, 2).

    The direction runs as the face does. None where too few cells lie near it, or too close
    together. Iteratively reweighted least squares: a cell with residual r weighs
    1 / (1 + (2 r / cell size)²)². It starts from the offset with the most cells; of two alike, as
    of the faces of a thin wall, from the one nearer to the expected face.
    """
    from scipy.spatial import cKDTree

    length_m = float(np.linalg.norm(face_m[1] - face_m[0]))
    along = (face_m[1] - face_m[0]) / length_m
    normal = np.array([-along[1], along[0]])
    end_m = min(_END_M, _END_FRACTION * length_m)

    def points_near_face(points_m: FloatArray, band_m: float) -> tuple[FloatArray, FloatArray]:
        """The points, of (N, 2), near the face, and their offsets from it, positive to its left."""
        along_m, offset_m = (points_m - face_m[0]) @ along, (points_m - face_m[0]) @ normal
        near = (np.abs(offset_m) <= band_m) & (along_m >= end_m) & (along_m <= length_m - end_m)
        return points_m[near], offset_m[near]

    occupied_m, offset_m = points_near_face(cells.occupied_m, BAND_M)
    free_m, free_offset_m = points_near_face(cells.free_m, _SIDE_M)
    if len(free_m):
        side = 1.0 if np.sign(free_offset_m).sum() > 0.0 else -1.0
        next_m = occupied_m + side * cells.resolution_m * normal
        gap_m, _ = cKDTree(free_m).query(next_m)
        is_front = np.asarray(gap_m) <= _NEXT_CELLS * cells.resolution_m
        occupied_m, offset_m = occupied_m[is_front], offset_m[is_front]
    along_m = (occupied_m - face_m[0]) @ along
    if len(occupied_m) < _CELLS_MIN or np.ptp(along_m) < _SPAN_FRACTION_MIN * length_m:
        return None
    point = face_m[0] + _mode_m(offset_m, cells.resolution_m) * normal
    direction: FloatArray = along
    for _ in range(_ITERATIONS):
        residual = (occupied_m - point) @ np.array([-direction[1], direction[0]])
        weights = (1.0 + (2.0 * residual / cells.resolution_m) ** 2) ** -2
        weights /= weights.sum()
        point = weights @ occupied_m
        centred_m = occupied_m - point
        # The eigenvector of the larger eigenvalue.
        _, vectors = np.linalg.eigh((weights[:, None] * centred_m).T @ centred_m)
        before, direction = direction, vectors[:, 1]
        direction = direction if direction @ along >= 0.0 else -direction
        if abs(before[0] * direction[1] - before[1] * direction[0]) < 1e-9:
            break
    # Scattered cells may fit best in any direction.
    return (point, direction) if direction @ along > np.sqrt(0.5) else None


def _mode_m(offset_m: FloatArray, resolution_m: float) -> float:
    """The offset, of those of the cells, with the highest density; nearer offsets weigh more."""
    distance_cells = np.abs(offset_m[:, None] - offset_m[None, :]) / resolution_m
    density = np.maximum(1.0 - distance_cells, 0.0).sum(axis=1)
    density = density * (1.0 - 0.5 * np.abs(offset_m) / BAND_M)
    return float(offset_m[np.argmax(density)])


def _count_measured(measurements: Sequence[Measurement]) -> dict[str, Any]:
    missed = [own.name for own in measurements if not np.isfinite(own.value)]
    return {
        "total": len(measurements),
        "measured": len(measurements) - len(missed),
        "missed": missed,
    }


def _mean(errors: Sequence[float]) -> float | None:
    return sum(errors) / len(errors) if errors else None
