"""How much of a world's obstacles a map shows: the detection rate f = S1 / S2 of Li 2022, eq. (10).

S2 is the length of the obstacles' outlines, sampled every centimetre; S1 is that of the samples
that are found: the middle of an occupied cell lies within one cell and 2 cm of them. The paper
measures by hand in a picture, and its S2 is "the total edge length of the actual obstacles": the
rate over all outlines is the one to set beside the paper's. The rate over what the sensors could
see shows what mapping alone loses.

(10) does not ask what a map shows that is not there. An occupied cell is false where no outline,
seen or not, lies within one cell and 2 cm of its middle: beside a noisy return in free space also
one that lies deeper than that behind a surface. The false cells are given as a fraction of the
occupied cells, and as a number per square metre mapped, which is the area of all cells that are
free or occupied.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fusion_core.evaluation.map_measures import MapCells
from fusion_core.model.conventions import BoolArray, FloatArray, read_only
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.world_outline import SENSORS, ObstacleOutline, WorldOutline

TOLERANCE_M = 0.02
"""In addition to one cell: the outline is sampled every centimetre, a wall's edge is no sharper."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObstacleDetection:
    """The length of one obstacle's outline, the samples found and those that could be seen.

    ``found``: (S,). ``visible``: (sensors, S) in the order of SENSORS.
    """

    name: str
    length_m: float
    found: BoolArray
    visible: BoolArray

    def __post_init__(self) -> None:
        read_only(self.found)
        read_only(self.visible)

    def to_json(self) -> dict[str, Any]:
        """Lengths and rates; the rate of no length is null."""
        return {"name": self.name, **_detection_rates([self])}


@dataclass(frozen=True, slots=True, kw_only=True)
class OutlineReport:
    """Detection of each obstacle, and how many of the map's occupied cells belong to none.

    ``mapped_m2``: the area of the free and the occupied cells together.
    """

    obstacles: tuple[ObstacleDetection, ...]
    tolerance_m: float
    occupied_cells: int
    false_cells: int
    mapped_m2: float

    def to_json(self) -> dict[str, Any]:
        """The rates over all obstacles, those of false obstacles, then each obstacle.

        A rate of nothing is null. ``false_obstacles``: of the occupied cells.
        """
        return {
            **_detection_rates(self.obstacles),
            "reach_m": self.tolerance_m,
            "occupied_cells": self.occupied_cells,
            "mapped_m2": self.mapped_m2,
            "false_cells": self.false_cells,
            "false_obstacles": self.false_cells / self.occupied_cells
            if self.occupied_cells
            else None,
            "false_cells_per_m2": self.false_cells / self.mapped_m2 if self.mapped_m2 else None,
            "obstacles": [obstacle.to_json() for obstacle in self.obstacles],
        }


def evaluate_outlines(cells: MapCells, world: WorldOutline) -> OutlineReport:
    """Compare a map's occupied cells, in the world's frame, with the outlines.

    Raises ScanLoomError for a world without obstacles.
    """
    if not world.obstacles:
        raise ScanLoomError(
            "The world has no obstacles to detect.",
            advice="Name the world file of the recording that the map was made of.",
        )
    tolerance_m = cells.resolution_m + TOLERANCE_M
    samples = [obstacle.samples_m() for obstacle in world.obstacles]
    found = _is_near(np.concatenate(samples), cells.occupied_m, tolerance_m)
    ends = np.cumsum([len(own) for own in samples])
    is_false = ~_is_near(cells.occupied_m, np.concatenate(samples), tolerance_m)
    return OutlineReport(
        obstacles=tuple(
            _detect_obstacle(obstacle, found[end - len(own) : end])
            for obstacle, own, end in zip(world.obstacles, samples, ends, strict=True)
        ),
        tolerance_m=tolerance_m,
        occupied_cells=len(cells.occupied_m),
        false_cells=int(is_false.sum()),
        mapped_m2=cells.mapped_m2,
    )


def _detect_obstacle(obstacle: ObstacleOutline, found: BoolArray) -> ObstacleDetection:
    return ObstacleDetection(
        name=obstacle.name,
        length_m=obstacle.length_m,
        found=found.copy(),
        visible=np.stack([obstacle.seen_samples(sensor) for sensor in SENSORS]),
    )


def _is_near(points_m: FloatArray, others_m: FloatArray, tolerance_m: float) -> BoolArray:
    """(N,): whether any of the others (M, 2) lies within the tolerance of each point (N, 2)."""
    from scipy.spatial import cKDTree

    if len(others_m) == 0 or len(points_m) == 0:
        return np.zeros(len(points_m), dtype=np.bool_)
    # The tree leaves out what lies at the bound itself.
    bound_m = float(np.nextafter(tolerance_m, np.inf))
    nearest_m, _ = cKDTree(others_m).query(points_m, distance_upper_bound=bound_m)
    within: BoolArray = np.asarray(nearest_m) <= tolerance_m
    return within


def _detection_rates(obstacles: Sequence[ObstacleDetection]) -> dict[str, Any]:
    """Outline length, found length and rate (10): of all samples, of those visible to any sensor,
    and of those visible to each."""
    # The weight of a sample is the length of outline that it stands for.
    weights = np.concatenate([np.full(o.found.size, o.length_m / o.found.size) for o in obstacles])
    found = np.concatenate([o.found for o in obstacles])
    seen = np.concatenate([o.visible for o in obstacles], axis=1)
    figures: dict[str, Any] = {}
    parts = {"all": np.ones(found.size, dtype=np.bool_), "visible": seen.any(axis=0)}
    parts |= {f"visible_to_{sensor}": own for sensor, own in zip(SENSORS, seen, strict=True)}
    for name, part in parts.items():
        length_m = float(weights[part].sum())
        found_m = float(weights[part & found].sum())
        figures[name] = {
            "outline_m": length_m,
            "found_m": found_m,
            "rate": found_m / length_m if length_m > 0.0 else None,
        }
    return figures
