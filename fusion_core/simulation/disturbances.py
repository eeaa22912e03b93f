"""Disturbances that both sensors share: single spikes and bias in corners."""

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray


def isolated(shape: tuple[int, ...], fraction: float, rng: np.random.Generator) -> BoolArray:
    """About ``fraction`` of a curve (N,) or image (H, W), of which no two are neighbours.

    Neighbours in an image are the eight around a pixel.
    """
    drawn = rng.random(shape) < fraction
    padded = np.pad(drawn, 1)
    if len(shape) == 1:
        beside = padded[:-2]
    else:
        beside = padded[1:-1, :-2] | padded[:-2, :-2] | padded[:-2, 1:-1] | padded[:-2, 2:]
    single: BoolArray = drawn & ~beside
    return single


def nearer(surface_m: FloatArray, nearest_m: float, rng: np.random.Generator) -> FloatArray:
    """A random distance between the nearest that is measured and the surface, for each.

    Uniform in the inverse of the distance, so near ones are likelier: what an airborne particle
    returns falls with the square of its distance, and so does a step of disparity.
    """
    inverse = rng.uniform(0.0, 1.0, surface_m.shape)
    # A surface that is nearer still has nothing before it.
    near = 1.0 / np.minimum(nearest_m, surface_m)
    far = 1.0 / surface_m
    distance_m: FloatArray = 1.0 / (far + inverse * (near - far))
    return distance_m


def corner_bias_m(corner_m: FloatArray, bias_m: float, span_m: float) -> FloatArray:
    """How much too far a sample reads that lies ``corner_m`` from a concave corner.

    ``bias_m`` in the corner, falling linearly to 0 at ``span_m``.
    """
    if span_m == 0.0:
        return np.zeros_like(corner_m)
    return bias_m * np.maximum(1.0 - corner_m / span_m, 0.0)


def strictly_between(
    value_m: FloatArray, one_m: FloatArray, other_m: FloatArray, step_m: float
) -> FloatArray:
    """The values moved to whole steps between two surfaces, which lie over two steps apart."""
    lower = np.floor(np.minimum(one_m, other_m) / step_m) + 1.0
    upper = np.ceil(np.maximum(one_m, other_m) / step_m) - 1.0
    moved_m: FloatArray = np.clip(value_m, lower * step_m, upper * step_m)
    return moved_m
