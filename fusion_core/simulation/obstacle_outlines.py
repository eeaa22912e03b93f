"""Outlines of the obstacles of a world, from the solids that it is made of.

A part of an edge belongs to an outline where the floor beside it is free. What touches a wall or
lies inside another solid has no outline there: no sensor could see it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.world_outline import ObstacleOutline
from fusion_core.simulation.solids import Opening, Prism, SolidObject, rectangle

ROBOT_HEIGHT_M = 0.55
"""Li 2022, section 4.1: the height of the robot."""

MIN_OBSTACLE_HEIGHT_M = 0.01
"""Li 2022, section 2.2: lower objects belong to the floor."""

# How far beside an edge the floor is probed: less than any gap between two objects.
_PROBE_OFFSET_M = 1e-4
# Nearer points are one: far above rounding at the size of a building.
_COINCIDENCE_TOLERANCE_M = 1e-6


@dataclass(frozen=True, slots=True)
class Edge:
    """An edge of a solid's footprint from a to b, with free floor on its right.

    ``heights_m``: the lower and the upper end of the solid above the floor.
    """

    a: FloatArray
    b: FloatArray
    heights_m: tuple[float, float]


def outer_wall_edges(
    size_m: tuple[float, float],
    openings: Sequence[Sequence[Opening]],
    height_m: float,
) -> dict[str, list[Edge]]:
    """The walls around 0…size, by name, without the openings that a robot can drive through."""
    width, depth = size_m
    corners = rectangle((0.0, 0.0, width, depth))
    walls: dict[str, list[Edge]] = {}
    for side, name in enumerate(("south wall", "east wall", "north wall", "west wall")):
        start, end = corners[side], corners[(side + 1) % 4]
        along = (end - start) / np.linalg.norm(end - start)
        stops = [0.0, float(np.linalg.norm(end - start))]
        for opening in openings[side]:
            lintel_in_reach = opening.top_m < ROBOT_HEIGHT_M
            sill = opening.bottom_m > MIN_OBSTACLE_HEIGHT_M
            pane = opening.glazed and opening.bottom_m < ROBOT_HEIGHT_M
            if not (lintel_in_reach or sill or pane):
                stops[-1:-1] = [opening.start_m, opening.end_m]
        # Anticlockwise corners have the room on their left: the edges run back.
        walls[name] = [
            Edge(start + along * s1, start + along * s0, (0.0, height_m))
            for s0, s1 in zip(stops[::2], stops[1::2], strict=True)
        ]
    return walls


def obstacle_outlines(
    walls: dict[str, list[Edge]],
    objects: Sequence[SolidObject],
    size_m: tuple[float, float],
) -> tuple[ObstacleOutline, ...]:
    """The outline of every obstacle between the floor and the robot's height, walls first.

    Objects of the same name are numbered, and so are the parts of an object on several legs.
    ``seen_by`` is empty: ``VisibilityTracker`` fills it in.
    """
    counts = {solid.name: 0 for solid in objects}
    for solid in objects:
        counts[solid.name] += 1
    numbers = dict.fromkeys(counts, 0)
    edges: list[tuple[str, list[Edge]]] = list(walls.items())
    solids: list[Prism] = []
    for solid in objects:
        numbers[solid.name] += 1
        name = solid.name if counts[solid.name] == 1 else f"{solid.name} {numbers[solid.name]}"
        prisms = [prism for prism in solid.prisms if _is_obstacle(prism)]
        solids += prisms
        edges.append((name, [edge for prism in prisms for edge in _prism_edges(prism)]))
    bounds = np.array([(p.corners_m.min(axis=0), p.corners_m.max(axis=0)) for p in solids])
    bounds = bounds.reshape(-1, 2, 2)
    found: list[ObstacleOutline] = []
    exposed: list[Edge] = []
    for name, own in edges:
        before = len(exposed)
        for edge in own:
            exposed += _exposed_parts(edge, exposed, solids, bounds, size_m)
        chains = _join_edges(exposed[before:])
        found += [
            ObstacleOutline(
                name=name if len(chains) == 1 else f"{name}, part {number}",
                z_min_m=heights_m[0],
                z_max_m=heights_m[1],
                outline_m=outline_m,
                seen_by={},
            )
            for number, (outline_m, heights_m) in enumerate(chains, start=1)
        ]
    return tuple(found)


def _is_obstacle(prism: Prism) -> bool:
    low_m, high_m = prism.heights_m
    return low_m < ROBOT_HEIGHT_M and high_m > MIN_OBSTACLE_HEIGHT_M


def _prism_edges(prism: Prism) -> list[Edge]:
    corners = prism.corners_m
    return [
        Edge(corners[i], corners[(i + 1) % len(corners)], prism.heights_m)
        for i in range(len(corners))
    ]


def _exposed_parts(
    edge: Edge,
    known: Sequence[Edge],
    solids: Sequence[Prism],
    bounds: FloatArray,
    size_m: tuple[float, float],
) -> list[Edge]:
    """The parts of an edge with free floor on the right that are not in ``known`` edges."""
    a, along = edge.a, edge.b - edge.a
    length_m = float(np.linalg.norm(along))
    outward = np.array([along[1], -along[0]]) / length_m
    low, high = np.minimum(a, edge.b) - 1e-3, np.maximum(a, edge.b) + 1e-3
    beside_it = (bounds[:, 0] <= high).all(axis=1) & (bounds[:, 1] >= low).all(axis=1)
    nearby = [solids[index].corners_m for index in np.flatnonzero(beside_it).tolist()]
    stops = {0.0, 1.0}
    for corners in nearby:
        sides = np.roll(corners, -1, axis=0) - corners
        slope = sides[:, 0] * along[1] - sides[:, 1] * along[0]
        height = sides[:, 0] * (corners[:, 1] - a[1]) - sides[:, 1] * (corners[:, 0] - a[0])
        crossed = np.abs(slope) > 1e-12
        fractions = height[crossed] / slope[crossed]
        stops |= {float(fraction) for fraction in fractions if 0.0 < fraction < 1.0}
    ordered = sorted(stops)
    parts: list[Edge] = []
    for s0, s1 in pairwise(ordered):
        if (s1 - s0) * length_m < _COINCIDENCE_TOLERANCE_M:
            continue
        middle = a + 0.5 * (s0 + s1) * along
        beside = middle + _PROBE_OFFSET_M * outward
        # No robot drives outside the world.
        free = bool((beside > 0.0).all()) and beside[0] < size_m[0] and beside[1] < size_m[1]
        free = free and not any(_contains(corners, beside) for corners in nearby)
        if free and not any(_lies_on(other, middle, outward) for other in known):
            parts.append(Edge(a + s0 * along, a + s1 * along, edge.heights_m))
    return parts


def _contains(corners: FloatArray, point: FloatArray) -> bool:
    sides = np.roll(corners, -1, axis=0) - corners
    to_point = point - corners
    return bool((sides[:, 0] * to_point[:, 1] - sides[:, 1] * to_point[:, 0] >= 0.0).all())


def _lies_on(edge: Edge, point: FloatArray, outward: FloatArray) -> bool:
    """Whether a point lies on an edge that faces the same way."""
    along = edge.b - edge.a
    length_m = float(np.linalg.norm(along))
    u = along / length_m
    along_m = float(u @ (point - edge.a))
    off = abs(float(u[0] * (point - edge.a)[1] - u[1] * (point - edge.a)[0]))
    same_way = u[1] * outward[0] - u[0] * outward[1] > 0.999
    return (
        off < _COINCIDENCE_TOLERANCE_M
        and -_COINCIDENCE_TOLERANCE_M < along_m < length_m + _COINCIDENCE_TOLERANCE_M
        and bool(same_way)
    )


def _join_edges(edges: Sequence[Edge]) -> list[tuple[FloatArray, tuple[float, float]]]:
    """Edges joined end to start into polylines, each with the heights of its edges together."""
    left = list(edges)
    ends = {_grid_key(edge.b) for edge in left}
    # Open polylines start where nothing ends; what is left then are rings.
    left.sort(key=lambda edge: _grid_key(edge.a) in ends)
    chains = []
    while left:
        edge = left.pop(0)
        points = [edge.a, edge.b]
        lows, highs = [edge.heights_m[0]], [edge.heights_m[1]]
        while (following := _find_edge_from(left, points[-1])) is not None:
            edge = left.pop(following)
            lows.append(edge.heights_m[0])
            highs.append(edge.heights_m[1])
            points.append(edge.b)
        chains.append((_drop_collinear(np.array(points)), (min(lows), max(highs))))
    return chains


def _find_edge_from(edges: Sequence[Edge], point: FloatArray) -> int | None:
    return next((i for i, edge in enumerate(edges) if _grid_key(edge.a) == _grid_key(point)), None)


def _drop_collinear(points: FloatArray) -> FloatArray:
    """The polyline without its points on straight stretches."""
    ahead = np.diff(points, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    bends = np.abs(ahead[:-1, 0] * ahead[1:, 1] - ahead[:-1, 1] * ahead[1:, 0]) > 1e-9
    kept: FloatArray = points[np.concatenate([[True], bends, [True]])]
    return kept


def _grid_key(point: FloatArray) -> tuple[int, int]:
    return round(float(point[0]) / _COINCIDENCE_TOLERANCE_M / 10.0), round(
        float(point[1]) / _COINCIDENCE_TOLERANCE_M / 10.0
    )
