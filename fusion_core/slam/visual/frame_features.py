"""The ORB features of one image."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import (
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
    read_only,
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameFeatures:
    """``pixels``: (F, 2) u, v by the camera matrix alone: distortion is taken off.
    ``depths_m``: (F,), z along the optical axis, NaN where missing or at a depth edge. ``octaves``:
    (F,) level of the pyramid. ``angles_deg``: (F,) orientation. ``descriptors``: (F, 32) uint8.
    """

    pixels: FloatArray
    depths_m: FloatArray
    octaves: IntArray
    angles_deg: Float32Array
    descriptors: ByteArray

    def __post_init__(self) -> None:
        for array in (
            self.pixels,
            self.depths_m,
            self.octaves,
            self.angles_deg,
            self.descriptors,
        ):
            read_only(array)

    def __len__(self) -> int:
        return len(self.pixels)


def no_features() -> FrameFeatures:
    """Of an image that shows none."""
    return FrameFeatures(
        pixels=np.empty((0, 2)),
        depths_m=np.empty(0),
        octaves=np.empty(0, np.int64),
        angles_deg=np.empty(0, np.float32),
        descriptors=np.empty((0, 32), np.uint8),
    )
