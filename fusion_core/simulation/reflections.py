"""Panes and mirrors: what a ray meets after the first surface."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.simulation.ray_casting import Hits, RayCaster
from fusion_core.simulation.solids import Material

# How far past the first surface a ray goes on, so that it does not meet it again; in units of
# the ray's direction vector.
_PAST = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class SecondSurface:
    """What lies behind panes and over mirrors, for K of N rays.

    ``rays``: (K,) their indices. ``distance``: (K,) length of the whole way, over the mirror where
    there is one, in units of the ray's direction vector. ``points_m``: (K, 3) where it ends.
    ``hits``: of the second part of the way. A second pane or mirror ends it like any surface.
    """

    rays: IntArray
    distance: FloatArray
    points_m: FloatArray
    hits: Hits

    def among(self, count: int) -> FloatArray:
        """(count,) the distances in the order of all rays, NaN where there is no second surface."""
        distance = np.full(count, np.nan)
        distance[self.rays] = self.distance
        return distance


def second_surfaces(
    caster: RayCaster, origins_m: FloatArray, directions: FloatArray, first: Hits, time_s: float
) -> SecondSurface:
    """Rays (N, 3) that met a pane go straight on; those that met a mirror are reflected.

    ``origins_m``: (N, 3) or (3,).
    """
    origins_m = np.broadcast_to(origins_m, directions.shape)
    mirror = first.materials == Material.MIRROR
    rays: IntArray = np.flatnonzero(mirror | (first.materials == Material.GLASS)).astype(np.int64)
    onward = directions[rays]
    normals = first.normals[rays]
    fold = 2.0 * mirror[rays] * np.einsum("ij,ij->i", onward, normals)
    reflected = onward - fold[:, None] * normals
    met_m = origins_m[rays] + first.distance[rays, None] * onward
    starts_m = met_m + _PAST * reflected
    hits = caster.cast(starts_m, reflected, time_s)
    return SecondSurface(
        rays=rays,
        distance=first.distance[rays] + _PAST + hits.distance,
        points_m=starts_m + hits.distance[:, None] * reflected,
        hits=hits,
    )
