"""What is painted on the things of an office, and on its walls."""

from collections.abc import Mapping, Sequence

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.simulation import textures
from fusion_core.simulation.solids import Mesh, SolidObject
from fusion_core.simulation.textures import Painter, Texture

_TEXEL_M = 0.003
LARGE_TEXEL_M = 0.004
"""Side of a texel of a floor or a wall."""
_SKIRTING_M = 0.08

Faces = tuple[Painter | None, Painter | None]
"""The painters of an object's upright and of its level faces; None leaves them plain."""


def paint_object(
    solid: SolidObject, faces: Faces, rng: np.random.Generator
) -> list[Texture | None]:
    """A texture, or None, for each rectangle of an object."""
    quads = quad_edges(solid.mesh)
    middle = 0.5 * (solid.mesh.corners_m.min(axis=(0, 1)) + solid.mesh.corners_m.max(axis=(0, 1)))
    found: list[Texture | None] = []
    for corner, a, b in quads:
        level = abs(np.cross(a, b)[2]) > 1e-9
        # Nobody looks at an object from below.
        painter = (faces[1] if corner[2] > middle[2] else None) if level else faces[0]
        if painter is None:
            found.append(None)
            continue
        texture = textures.paint(painter, texels(a, b), rng)
        outwards = corner + 0.5 * (a + b) - middle
        found.append(texture if np.cross(a, b) @ outwards > 0.0 else textures.mirrored(texture))
    return found


def paint_wall(
    length_m: float,
    height_m: float,
    boards: Sequence[tuple[float, float, float, float]],
    rng: np.random.Generator,
) -> Texture:
    """A plain wall with a skirting board, and boards full of print: each its distance from the
    wall's left end and from the floor, its width and its height, as seen from the room."""
    shape = texels(np.array([length_m, 0.0, 0.0]), np.array([0.0, 0.0, height_m]), LARGE_TEXEL_M)
    pictures = []
    for along_m, above_m, width_m, tall_m in boards:
        size = round(tall_m / LARGE_TEXEL_M), round(width_m / LARGE_TEXEL_M)
        row = shape[0] - round(above_m / LARGE_TEXEL_M) - size[0]
        pictures.append(
            (row, round(along_m / LARGE_TEXEL_M), textures.paint(textures.poster, size, rng))
        )
    wall = textures.stand_on_skirting(
        textures.paint(textures.plaster, shape, rng), round(_SKIRTING_M / LARGE_TEXEL_M)
    )
    return textures.hang(wall, pictures, rng)


def paint_objects(
    objects: Sequence[SolidObject], faces_of: Mapping[str, Faces], rng: np.random.Generator
) -> list[Texture | None]:
    """The textures of all rectangles of objects, in order; ``faces_of`` is by name."""
    found: list[Texture | None] = []
    for solid in objects:
        found += paint_object(solid, faces_of[solid.name], rng)
    return found


def quad_edges(mesh: Mesh) -> FloatArray:
    """(Q, 3, 3): a corner and the two edges from it, of each rectangle of two triangles."""
    first, second = mesh.corners_m[::2], mesh.corners_m[1::2]
    corner = first[:, 0]
    return np.stack([corner, first[:, 1] - corner, second[:, 2] - corner], axis=1)


def texels(
    edge_a_m: FloatArray, edge_b_m: FloatArray, texel_m: float = _TEXEL_M
) -> tuple[int, int]:
    """Rows and columns of the texture of a rectangle."""
    a, b = float(np.linalg.norm(edge_a_m)), float(np.linalg.norm(edge_b_m))
    return max(8, round(b / texel_m)), max(8, round(a / texel_m))
