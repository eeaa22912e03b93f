"""The outlines of what stands in a robot's way, from the solids that a world is made of.

A piece of an edge counts where the floor beside it is free: what touches a wall, or lies inside
of something else, has no outline there, and no sensor could ever see one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fusion_core.model.conventions import FloatArray, read_only
from fusion_core.simulation.solids import Opening, Piece, Prism, rectangle

ROBOT_HEIGHT_M = 0.55
"""Li 2022, section 4.1: how high the robot is in all."""

FLOOR_M = 0.01
"""Li 2022, section 2.2: what is lower belongs to the floor."""

# Beside an edge, and near enough to be free of what stands there.
_BESIDE_M = 1e-4
_SAME_M = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """An outline (N, 2), open or with its last point as its first, and how high it stands."""

    name: str
    heights_m: tuple[float, float]
    outline_m: FloatArray

    def __post_init__(self) -> None:
        read_only(self.outline_m)


@dataclass(frozen=True, slots=True)
class Edge:
    """From a to b, with free floor on its right, of something that stands so high."""

    a: FloatArray
    b: FloatArray
    heights_m: tuple[float, float]


def outer_walls(
    size_m: tuple[float, float],
    openings: Sequence[Sequence[Opening]],
    height_m: float,
) -> dict[str, list[Edge]]:
    """The walls around 0…size, by name, without what one could drive through."""
    width, depth = size_m
    corners = rectangle((0.0, 0.0, width, depth))
    walls: dict[str, list[Edge]] = {}
    for side, name in enumerate(("south wall", "east wall", "north wall", "west wall")):
        start, end = corners[side], corners[(side + 1) % 4]
        along = (end - start) / np.linalg.norm(end - start)
        stops = [0.0, float(np.linalg.norm(end - start))]
        for opening in openings[side]:
            lintel_in_reach = opening.top_m < ROBOT_HEIGHT_M
            sill = opening.bottom_m > FLOOR_M
            pane = opening.glazed and opening.bottom_m < ROBOT_HEIGHT_M
            if not (lintel_in_reach or sill or pane):
                stops[-1:-1] = [opening.start_m, opening.end_m]
        # Anticlockwise corners have the room on their left: the edges run back.
        walls[name] = [
            Edge(start + along * s1, start + along * s0, (0.0, height_m))
            for s0, s1 in zip(stops[::2], stops[1::2], strict=True)
        ]
    return walls


def standing_outlines(
    walls: dict[str, list[Edge]],
    pieces: Sequence[Piece],
    size_m: tuple[float, float],
) -> tuple[Standing, ...]:
    """Everything between the floor and the robot's height, walls first.

    Pieces of one name are numbered, and so are the parts of what stands on several feet.
    """
    reached = {piece.name: 0 for piece in pieces}
    for piece in pieces:
        reached[piece.name] += 1
    numbers = dict.fromkeys(reached, 0)
    edges: list[tuple[str, list[Edge]]] = list(walls.items())
    solids: list[Prism] = []
    for piece in pieces:
        numbers[piece.name] += 1
        name = piece.name if reached[piece.name] == 1 else f"{piece.name} {numbers[piece.name]}"
        prisms = [prism for prism in piece.prisms if _in_the_way(prism)]
        solids += prisms
        edges.append((name, [edge for prism in prisms for edge in _edges(prism)]))
    bounds = np.array([(p.corners_m.min(axis=0), p.corners_m.max(axis=0)) for p in solids])
    bounds = bounds.reshape(-1, 2, 2)
    found: list[Standing] = []
    exposed: list[Edge] = []
    for name, own in edges:
        before = len(exposed)
        for edge in own:
            exposed += _exposed(edge, exposed, solids, bounds, size_m)
        chains = _chains(exposed[before:])
        found += [
            Standing(
                name=name if len(chains) == 1 else f"{name}, part {number}",
                heights_m=heights_m,
                outline_m=outline_m,
            )
            for number, (outline_m, heights_m) in enumerate(chains, start=1)
        ]
    return tuple(found)


def _in_the_way(prism: Prism) -> bool:
    low_m, high_m = prism.heights_m
    return low_m < ROBOT_HEIGHT_M and high_m > FLOOR_M


def _edges(prism: Prism) -> list[Edge]:
    corners = prism.corners_m
    return [
        Edge(corners[i], corners[(i + 1) % len(corners)], prism.heights_m)
        for i in range(len(corners))
    ]


def _exposed(
    edge: Edge,
    before: Sequence[Edge],
    solids: Sequence[Prism],
    bounds: FloatArray,
    size_m: tuple[float, float],
) -> list[Edge]:
    """The parts of an edge with free floor on the right that are not among those ``before``."""
    a, along = edge.a, edge.b - edge.a
    length_m = float(np.linalg.norm(along))
    outward = np.array([along[1], -along[0]]) / length_m
    low, high = np.minimum(a, edge.b) - 1e-3, np.maximum(a, edge.b) + 1e-3
    beside_it = (bounds[:, 0] <= high).all(axis=1) & (bounds[:, 1] >= low).all(axis=1)
    near = [solids[index].corners_m for index in np.flatnonzero(beside_it).tolist()]
    stops = {0.0, 1.0}
    for corners in near:
        sides = np.roll(corners, -1, axis=0) - corners
        slope = sides[:, 0] * along[1] - sides[:, 1] * along[0]
        height = sides[:, 0] * (corners[:, 1] - a[1]) - sides[:, 1] * (corners[:, 0] - a[0])
        crossed = np.abs(slope) > 1e-12
        shares = height[crossed] / slope[crossed]
        stops |= {float(share) for share in shares if 0.0 < share < 1.0}
    ordered = sorted(stops)
    parts: list[Edge] = []
    for s0, s1 in pairwise(ordered):
        if (s1 - s0) * length_m < _SAME_M:
            continue
        middle = a + 0.5 * (s0 + s1) * along
        beside = middle + _BESIDE_M * outward
        # Outside of the world nobody drives.
        free = bool((beside > 0.0).all()) and beside[0] < size_m[0] and beside[1] < size_m[1]
        free = free and not any(_contains(corners, beside) for corners in near)
        if free and not any(_on(other, middle, outward) for other in before):
            parts.append(Edge(a + s0 * along, a + s1 * along, edge.heights_m))
    return parts


def _contains(corners: FloatArray, point: FloatArray) -> bool:
    sides = np.roll(corners, -1, axis=0) - corners
    to_point = point - corners
    return bool((sides[:, 0] * to_point[:, 1] - sides[:, 1] * to_point[:, 0] >= 0.0).all())


def _on(edge: Edge, point: FloatArray, outward: FloatArray) -> bool:
    """Whether a point lies on an edge that faces the same way."""
    along = edge.b - edge.a
    length_m = float(np.linalg.norm(along))
    u = along / length_m
    reach = float(u @ (point - edge.a))
    off = abs(float(u[0] * (point - edge.a)[1] - u[1] * (point - edge.a)[0]))
    same_way = u[1] * outward[0] - u[0] * outward[1] > 0.999
    return off < _SAME_M and -_SAME_M < reach < length_m + _SAME_M and bool(same_way)


def _chains(edges: Sequence[Edge]) -> list[tuple[FloatArray, tuple[float, float]]]:
    """Edges joined end to start into polylines, each with the heights of its edges together."""
    left = list(edges)
    ends = {_key(edge.b) for edge in left}
    # Open polylines start where nothing ends; what is left then are rings.
    left.sort(key=lambda edge: _key(edge.a) in ends)
    chains = []
    while left:
        edge = left.pop(0)
        points = [edge.a, edge.b]
        lows, highs = [edge.heights_m[0]], [edge.heights_m[1]]
        while (following := _starting_at(left, points[-1])) is not None:
            edge = left.pop(following)
            lows.append(edge.heights_m[0])
            highs.append(edge.heights_m[1])
            points.append(edge.b)
        chains.append((_without_straight(np.array(points)), (min(lows), max(highs))))
    return chains


def _starting_at(edges: Sequence[Edge], point: FloatArray) -> int | None:
    return next((i for i, edge in enumerate(edges) if _key(edge.a) == _key(point)), None)


def _without_straight(points: FloatArray) -> FloatArray:
    """The polyline without the points at which it does not bend."""
    ahead = np.diff(points, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    bends = np.abs(ahead[:-1, 0] * ahead[1:, 1] - ahead[:-1, 1] * ahead[1:, 0]) > 1e-9
    kept: FloatArray = points[np.concatenate([[True], bends, [True]])]
    return kept


def _key(point: FloatArray) -> tuple[int, int]:
    return round(float(point[0]) / _SAME_M / 10.0), round(float(point[1]) / _SAME_M / 10.0)
