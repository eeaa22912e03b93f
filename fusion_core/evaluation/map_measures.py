"""Lengths and angles measured in a map, and their errors: Table 4 of Li 2022.

Where the paper measures by hand, here a line is fitted to the occupied cells near each face, and
what is measured lies between the lines. The paper's relative error of lines is the sum of the
absolute errors over the sum of the lengths.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.world_outline import MeasuredAngle, MeasuredLine, WorldOutline

BAND_M = 0.15
"""Cells nearer than this to where a face should be are taken for its own."""

# At a face's ends the cells of what joins it there begin.
_END_M = 0.1
_END_SHARE = 0.2
_CELLS_MIN = 4
# Cells on less than this share of a face tell little of its direction.
_SPAN_MIN = 0.3
_ITERATIONS = 30


@dataclass(frozen=True, slots=True)
class Measured:
    """A true value and the one in the map, NaN where the map does not show what it needs."""

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

    lines: tuple[Measured, ...]
    angles: tuple[Measured, ...]

    def to_json(self) -> dict[str, Any]:
        """Each line and angle, and the means over those that the map shows."""
        lines = [line for line in self.lines if np.isfinite(line.value)]
        angles = [angle for angle in self.angles if np.isfinite(angle.value)]
        errors_m = [abs(line.error) for line in lines]
        true_m = [line.true for line in lines]
        return {
            "lines": {
                "measured": len(lines),
                "mean_absolute_error_m": _mean(errors_m),
                "relative_error": sum(errors_m) / sum(true_m) if lines else None,
                "each": [line.to_json("m") for line in self.lines],
            },
            "angles": {
                "measured": len(angles),
                "mean_absolute_error_deg": _mean([abs(angle.error) for angle in angles]),
                "each": [angle.to_json("deg") for angle in self.angles],
            },
        }


def evaluate_measures(
    occupied_m: FloatArray, resolution_m: float, world: WorldOutline
) -> MeasureReport:
    """Measure the world's lines and angles among a map's occupied cells (N, 2) in its frame."""
    return MeasureReport(
        lines=tuple(_length(line, occupied_m, resolution_m) for line in world.lines),
        angles=tuple(_angle(angle, occupied_m, resolution_m) for angle in world.angles),
    )


def _length(line: MeasuredLine, occupied_m: FloatArray, resolution_m: float) -> Measured:
    fits = [fit_face(face, occupied_m, resolution_m) for face in line.faces_m]
    first, second = fits
    if first is None or second is None:
        return Measured(line.name, line.length_m, float("nan"))
    # From the middle of the shorter face straight across to the other, whose direction is the
    # better known; of two alike neither is preferred.
    apart = second[0] - first[0]
    off_m = [abs(float(d[0] * apart[1] - d[1] * apart[0])) for _, d in (first, second)]
    lengths_m = np.linalg.norm(line.faces_m[:, 1] - line.faces_m[:, 0], axis=1)
    weights = lengths_m**2 / (lengths_m**2).sum()
    return Measured(line.name, line.length_m, float(weights @ off_m))


def _angle(angle: MeasuredAngle, occupied_m: FloatArray, resolution_m: float) -> Measured:
    true_deg = float(np.degrees(angle.angle_rad))
    fits = [fit_face(arm, occupied_m, resolution_m) for arm in angle.arms_m]
    first, second = fits
    if first is None or second is None:
        return Measured(angle.name, true_deg, float("nan"))
    cosine = float(np.clip(first[1] @ second[1], -1.0, 1.0))
    return Measured(angle.name, true_deg, float(np.degrees(np.arccos(cosine))))


def fit_face(
    face_m: FloatArray, occupied_m: FloatArray, resolution_m: float
) -> tuple[FloatArray, FloatArray] | None:
    """A point (2,) and the unit direction (2,) of the line through the cells of a face (2, 2).

    The direction runs as the face does. None where too few cells lie near it, or too close
    together. Least squares across the line, each cell weighted by 1 / (1 + (2 r / cell)²)²,
    from where most cells lie on; of two alike, as the faces of a thin wall, the one expected.
    """
    length_m = float(np.linalg.norm(face_m[1] - face_m[0]))
    along = (face_m[1] - face_m[0]) / length_m
    normal = np.array([-along[1], along[0]])
    reach, off = (occupied_m - face_m[0]) @ along, (occupied_m - face_m[0]) @ normal
    end_m = min(_END_M, _END_SHARE * length_m)
    near = (np.abs(off) <= BAND_M) & (reach >= end_m) & (reach <= length_m - end_m)
    cells = occupied_m[near]
    if len(cells) < _CELLS_MIN or np.ptp(reach[near]) < _SPAN_MIN * length_m:
        return None
    point = face_m[0] + _crest_m(off[near], resolution_m) * normal
    direction: FloatArray = along
    for _ in range(_ITERATIONS):
        residual = (cells - point) @ np.array([-direction[1], direction[0]])
        weights = (1.0 + (2.0 * residual / resolution_m) ** 2) ** -2
        weights /= weights.sum()
        point = weights @ cells
        offset = cells - point
        # The eigenvector of the larger eigenvalue.
        _, vectors = np.linalg.eigh((weights[:, None] * offset).T @ offset)
        before, direction = direction, vectors[:, 1]
        direction = direction if direction @ along >= 0.0 else -direction
        if abs(before[0] * direction[1] - before[1] * direction[0]) < 1e-9:
            break
    # Scattered cells may fit best in any direction.
    return (point, direction) if direction @ along > np.sqrt(0.5) else None


def _crest_m(off_m: FloatArray, resolution_m: float) -> float:
    """The offset (of one of the cells) about which most cells lie, nearer ones preferred."""
    beside = np.abs(off_m[:, None] - off_m[None, :]) / resolution_m
    crowd = np.maximum(1.0 - beside, 0.0).sum(axis=1) * (1.0 - 0.5 * np.abs(off_m) / BAND_M)
    return float(off_m[np.argmax(crowd)])


def _mean(errors: Sequence[float]) -> float | None:
    return sum(errors) / len(errors) if errors else None
