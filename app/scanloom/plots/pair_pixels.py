"""The pixels that a scan's beams are paired with, and their classes."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import BoolArray, Float32Array, IntArray
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_match import FrameMatch


@dataclass(frozen=True, slots=True, kw_only=True)
class PairPixels:
    """Arrays over the B beams in view, in the upright view's pixels.

    ``beam``: index in the scan; ``row``, ``column``: -1 where the beam has no pixel;
    ``noise_class``: codes of NoiseClass for the pixels, -1 where there is none or none was given;
    ``repaired``: pixels whose value was replaced.
    """

    beam: IntArray
    row: IntArray
    column: IntArray
    noise_class: IntArray
    repaired: BoolArray

    def __post_init__(self) -> None:
        sizes = {array.shape for array in (self.beam, self.row, self.column, self.noise_class)}
        if sizes != {(self.beam.size,)} or self.repaired.shape != self.beam.shape:
            raise ValueError("the arrays of the pairs must all be (B,)")

    def shown(self, classes: Collection[NoiseClass]) -> BoolArray:
        """(B,): the pairs that have a pixel, of one of the classes or of none."""
        codes = [-1, *(int(noise) for noise in classes)]
        return (self.row >= 0) & np.isin(self.noise_class, codes)

    def beam_near(self, row: float, column: float, *, within_px: float = 6.0) -> int | None:
        """The beam whose pixel is nearest to a place, None where none is near."""
        distance_px = np.hypot(self.row - row, self.column - column)
        distance_px[self.row < 0] = np.inf
        if not distance_px.size or distance_px.min() > within_px:
            return None
        return int(self.beam[np.argmin(distance_px)])


def pixels_of_match(match: FrameMatch, fused: FusedFrame | None = None) -> PairPixels:
    """The pairs of a matched frame, with classes and repairs where it is fused."""
    pairs = match.correspondence
    noise_class = np.full(pairs.beam.size, -1)
    repaired = np.zeros(pairs.beam.size, dtype=np.bool_)
    if fused is not None:
        noise_class = fused.classes.depth_class
        repaired = fused.pixel_changed
    return PairPixels(
        beam=pairs.beam,
        row=pairs.row,
        column=pairs.column,
        noise_class=noise_class,
        repaired=repaired,
    )


def repaired_depth_m(frame: FusedFrame) -> Float32Array:
    """(H, W) upright view with the repaired pixels of the pairs."""
    depth_m, pairs = frame.match.depth_m.copy(), frame.match.correspondence
    changed = frame.pixel_changed
    row, column = pairs.row[changed], pairs.column[changed]
    depth_m[row, column] = frame.repair.depth_m[changed]
    return depth_m
