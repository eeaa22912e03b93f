"""A box-shaped room with painted walls and furniture, made of rectangular panels with textures.

The room's frame has a corner of the floor at its origin, x and y along the floor, z up.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray, read_only
from fusion_core.simulation import textures
from fusion_core.simulation.panels import TRIANGLES_PER_PANEL, Panel, read_paint
from fusion_core.simulation.random_streams import RandomStream, make_generator
from fusion_core.simulation.ray_casting import Hits, MeshCaster
from fusion_core.simulation.solids import join_meshes
from fusion_core.simulation.textures import Painter, Texture

SONG_ROOM_M = (6.453, 6.214, 2.582)
"""Length, width and height of Song 2022, Table 3, by a laser distance meter."""
_TEXEL_M = 0.003
_FLOOR_TEXEL_M = 0.006


@dataclass(frozen=True, slots=True, kw_only=True)
class TexturedRoom:
    """``size_m``: length, width and height. ``viewpoint_m``: (3,) where the sensors stand.
    ``heading_rad``: where the camera looks, from the room's x."""

    size_m: tuple[float, float, float]
    panels: tuple[Panel, ...]
    viewpoint_m: FloatArray
    heading_rad: float

    def __post_init__(self) -> None:
        read_only(self.viewpoint_m)


class RoomCaster:
    """Casts rays into a textured room, and reads what is painted where they end.

    ``footprint_m``: the diameter of a LiDAR's beam on a surface, over which its reflectance is
    averaged.
    """

    def __init__(self, room: TexturedRoom, footprint_m: float) -> None:
        panels = room.panels
        quads = [panel.mesh() for panel in panels]
        self._caster = MeshCaster(join_meshes(quads))
        self._panels = panels
        self._infrared = [_blurred(panel, footprint_m) for panel in panels]
        self._rgb = [panel.texture.rgb for panel in panels]

    def cast(self, origins_m: FloatArray, directions: FloatArray) -> Hits:
        """First surfaces met by rays from (N, 3) or (3,) along (N, 3)."""
        return self._caster.cast(np.broadcast_to(origins_m, directions.shape), directions)

    def infrared(self, hits: Hits, points_m: FloatArray) -> FloatArray:
        """(N,) reflectance at 905 nm of the points (N, 3) where rays hit; 0 where nothing is."""
        return self._sample(self._infrared, hits, points_m)[:, 0]

    def rgb(self, hits: Hits, points_m: FloatArray) -> FloatArray:
        """(N, 3) colours from 0 to 255 of the points (N, 3) where rays hit; black where nothing
        is."""
        return self._sample(self._rgb, hits, points_m)

    def _sample(
        self, images: Sequence[ByteArray | Float32Array], hits: Hits, points_m: FloatArray
    ) -> FloatArray:
        # The triangle -1 of a ray that hits nothing belongs to panel -1.
        panel_of = hits.triangles // TRIANGLES_PER_PANEL
        return read_paint(self._panels, images, panel_of, points_m)


def make_textured_room(seed: int, size_m: tuple[float, float, float]) -> TexturedRoom:
    """A room whose pictures and furniture, and the sensors' place among them, come from a seed."""
    rng = make_generator(seed, RandomStream.TEXTURES)
    length, width, height = size_m
    eye = np.array(
        [
            length * rng.uniform(0.42, 0.58),
            width - rng.uniform(2.2, 2.7),
            height * rng.uniform(0.48, 0.56),
        ]
    )
    panels = _shell(size_m, rng)
    for item in _furniture(eye, size_m, rng):
        panels += item
    heading_rad = 0.5 * np.pi + float(rng.uniform(-0.2, 0.2))
    return TexturedRoom(
        size_m=size_m, panels=tuple(panels), viewpoint_m=eye, heading_rad=heading_rad
    )


def _shell(size_m: tuple[float, float, float], rng: np.random.Generator) -> list[Panel]:
    length, width, height = size_m
    corners = np.array([(0, 0, 0), (length, 0, 0), (length, width, 0), (0, width, 0)], np.float64)
    up = np.array([0.0, 0.0, height])
    panels = []
    for side in range(4):
        start, end = corners[side], corners[(side + 1) % 4]
        # The wall that the camera faces has most to see.
        count = 24 if side == 2 else 10
        wall_texture = _painted_wall(float(np.linalg.norm(end - start)), height, count, rng)
        # Seen from inside, a wall runs from its end to its start, so that letters are not mirrored.
        panels.append(Panel(end, start - end, up, wall_texture))
    floor = _texels(length, width, _FLOOR_TEXEL_M)
    along_x, along_y = np.array([length, 0.0, 0.0]), np.array([0.0, width, 0.0])
    panels.append(Panel(np.zeros(3), along_x, along_y, textures.paint(textures.tiles, floor, rng)))
    panels.append(Panel(up, along_x, along_y, textures.paint(textures.plaster, floor, rng)))
    return panels


def _painted_wall(length: float, height: float, count: int, rng: np.random.Generator) -> Texture:
    shape = _texels(length, height, _TEXEL_M)
    base = textures.bricks if rng.random() < 0.4 else textures.plaster
    taken: list[tuple[int, int, int, int]] = []
    pictures = []
    for _ in range(40 * count):
        h, w = (round(float(side) / _TEXEL_M) for side in rng.uniform(0.28, 0.75, 2))
        if h >= shape[0] or w >= shape[1]:
            continue
        row, column = int(rng.integers(shape[0] - h)), int(rng.integers(shape[1] - w))
        place = (row - 12, column - 12, row + h + 12, column + w + 12)
        if any(_overlap(place, other) for other in taken):
            continue
        taken.append(place)
        painter = (textures.poster, textures.picture)[int(rng.random() < 0.3)]
        pictures.append((row, column, textures.paint(painter, (h, w), rng)))
        if len(pictures) == count:
            break
    return textures.hang(textures.paint(base, shape, rng), pictures, rng)


def _furniture(
    eye: FloatArray, size_m: tuple[float, float, float], rng: np.random.Generator
) -> list[list[Panel]]:
    length, width, height = size_m

    def u(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    x, y, z = (float(value) for value in eye)
    shelf_x, stack_x, table_x = x - u(1.0, 1.4), x + u(0.9, 1.3), x + u(-0.3, 0.3)
    stack = u(0.45, 0.6), u(0.35, 0.5)
    stack_y = width - u(0.5, 0.9)
    board_at = np.array([x + u(-0.5, 0.5), y + u(1.3, 1.6), z + u(-0.5, -0.35)])
    return [
        _box((shelf_x, width - 0.17), (u(0.6, 0.8), 0.34), (0.0, u(1.7, 2.1)), 0.0, "books", rng),
        _box((stack_x, stack_y), (0.5, 0.45), (0.0, stack[0]), u(-0.4, 0.4), "carton", rng),
        _box((stack_x, stack_y), (0.45, 0.4), (stack[0], sum(stack)), u(-0.4, 0.4), "carton", rng),
        _box(
            (stack_x, stack_y), (0.3, 0.3), (sum(stack), sum(stack) + 0.3), u(0, 0.7), "carton", rng
        ),
        _box((table_x, width - 0.6), (1.1, 0.6), (0.68, 0.74), u(-0.1, 0.1), "wood", rng),
        _box((table_x - 0.3, width - 0.6), (0.3, 0.25), (0.74, 1.04), u(-0.6, 0.6), "carton", rng),
        _box((table_x + 0.28, width - 0.5), (0.22, 0.2), (0.74, u(0.9, 1.2)), 0.4, "carton", rng),
        # From the ceiling, above what stands on the floor.
        _box(
            (x + u(0.3, 0.7), width - u(0.5, 0.9)),
            (0.5, 0.3),
            (height - u(0.5, 0.7), height),
            u(-0.5, 0.5),
            "carton",
            rng,
        ),
        [_board(board_at, u(-0.6, 0.6), u(-0.4, 0.4), (0.64, 0.48), textures.checkerboard, rng)],
        [
            _board(
                np.array([x - u(0.3, 0.7), y + u(1.4, 1.8), z + u(0.35, 0.6)]),
                u(-0.6, 0.6),
                u(-0.3, 0.3),
                (0.6, 0.45),
                textures.poster,
                rng,
            )
        ],
        # Behind and beside the sensors.
        _box((0.3, u(1.0, 2.5)), (0.6, u(1.0, 1.6)), (0.0, u(1.2, 2.2)), 0.0, "wood", rng),
        _box(
            (length - 0.25, u(1.5, 4.5)), (0.5, u(0.8, 1.4)), (0.0, u(0.7, 1.9)), 0.0, "wood", rng
        ),
        _box((u(1.5, 4.5), 0.3), (u(1.2, 2.0), 0.6), (0.0, u(0.5, 1.0)), 0.0, "wood", rng),
        _box((u(1.2, 2.0), u(1.0, 1.8)), (0.6, 0.5), (0.0, u(0.4, 0.9)), u(0, 1.5), "carton", rng),
        _box((u(4.2, 5.2), u(1.0, 2.0)), (0.5, 0.4), (0.0, u(0.4, 1.2)), u(0, 1.5), "carton", rng),
    ]


_FACES: dict[str, tuple[Painter, Painter]] = {
    "books": (textures.books, textures.wood),
    "carton": (textures.poster, textures.poster),
    "wood": (textures.wood, textures.wood),
}


def _box(
    center_m: tuple[float, float],
    size_m: tuple[float, float],
    heights_m: tuple[float, float],
    yaw_rad: float,
    kind: str,
    rng: np.random.Generator,
) -> list[Panel]:
    """Six faces of a box, turned about its middle; the front painter paints the two wide sides."""
    front, other = _FACES[kind]
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    a = np.array([c, s, 0.0]) * size_m[0]
    b = np.array([-s, c, 0.0]) * size_m[1]
    bottom, top = heights_m
    up = np.array([0.0, 0.0, top - bottom])
    start = np.array([*center_m, bottom]) - 0.5 * (a + b)
    # Each seen from outside runs from left to right.
    sides = [
        (start, a, up, front),
        (start + a, b, up, other),
        (start + a + b, -a, up, front),
        (start + b, -b, up, other),
        (start + up, a, b, other),
        (start + b, a, -b, other),
    ]
    return [_panel(*side, rng) for side in sides]


def _board(
    center_m: FloatArray,
    yaw_rad: float,
    pitch_rad: float,
    size_m: tuple[float, float],
    painter: Painter,
    rng: np.random.Generator,
) -> Panel:
    """A thin board that faces -y, turned and tilted."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    across = np.array([c, s, 0.0])
    back = np.array([-s, c, 0.0])
    up = np.cos(pitch_rad) * np.array([0.0, 0.0, 1.0]) + np.sin(pitch_rad) * back
    a, b = across * size_m[0], up * size_m[1]
    return _panel(center_m - 0.5 * (a + b), a, b, painter, rng)


def _panel(
    corner_m: FloatArray,
    edge_a_m: FloatArray,
    edge_b_m: FloatArray,
    painter: Painter,
    rng: np.random.Generator,
) -> Panel:
    shape = _texels(float(np.linalg.norm(edge_a_m)), float(np.linalg.norm(edge_b_m)), _TEXEL_M)
    return Panel(corner_m, edge_a_m, edge_b_m, textures.paint(painter, shape, rng))


def _texels(length_m: float, height_m: float, texel_m: float) -> tuple[int, int]:
    return max(8, round(height_m / texel_m)), max(8, round(length_m / texel_m))


def _overlap(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _blurred(panel: Panel, footprint_m: float) -> Float32Array:
    image = panel.texture.infrared
    # A disc of diameter d has a standard deviation of d/4 along each axis.
    sigma = 0.25 * footprint_m / panel.texel_m
    if sigma < 0.2:
        return image
    return cv2.GaussianBlur(image, (0, 0), sigma).astype(np.float32)
