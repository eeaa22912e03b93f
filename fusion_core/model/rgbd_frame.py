"""An image with its depth, as visual odometry and visual SLAM take it."""

from dataclasses import dataclass

from fusion_core.model.conventions import ByteArray, Float32Array, read_only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RgbdFrame:
    """One view of an RGB-D camera.

    ``gray``: (H, W) uint8. ``rgb``: (H, W, 3) uint8 of the same pixels, None where nobody needs
    it. ``depth_m``: (h, w) float32 of the same view, z along the optical axis, NaN where missing;
    its size may differ. Both are of the image as stored, with its distortion.
    """

    stamp_ns: int
    gray: ByteArray
    depth_m: Float32Array
    rgb: ByteArray | None = None

    def __post_init__(self) -> None:
        if self.gray.ndim != 2 or self.depth_m.ndim != 2:
            raise ValueError(f"(H, W) images, got {self.gray.shape} and {self.depth_m.shape}")
        if self.rgb is not None and self.rgb.shape != (*self.gray.shape, 3):
            raise ValueError(f"rgb must be {(*self.gray.shape, 3)}, got {self.rgb.shape}")
        for array in (self.gray, self.depth_m):
            read_only(array)
        if self.rgb is not None:
            read_only(self.rgb)
