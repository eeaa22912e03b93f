"""Which heights a camera sees at each distance, and at which heights a beam's surface stood.

A beam of a virtual scan frees the cells before its end, as if the camera had looked at all heights
there. Near by it does not: the seat of a chair rises above the image's upper edge, and from afar a
cable duct is lower than what counts as floor. A beam does not show that such a cell is free, so it
may free a cell only where it looks at a height at which something was seen there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, read_only, wrap_angle
from fusion_core.model.sensors import CameraIntrinsics, LaserScan

# An edge plane this near to the vertical (as the vertical part of its unit normal) bounds nothing.
_VERTICAL = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class BeamHeights:
    """Heights above the floor, of the N beams of a scan.

    ``surfaces_m``: (N, 2) the lowest and the highest point of what ended the beam, NaN where
    nothing did. ``lower``, ``upper``: (N, 2, 2) two lines each, height at distance 0 and its rise
    per metre: what is seen at a distance lies above both of the lower and below both of the upper.
    ``behind_m``: (K, N) distances of further surfaces in a beam's direction, seen over, below or
    beside the first one, NaN where there is none; ``behind_surfaces_m``: (K, N, 2) their heights.
    """

    surfaces_m: FloatArray
    lower: FloatArray
    upper: FloatArray
    behind_m: FloatArray
    behind_surfaces_m: FloatArray

    def __post_init__(self) -> None:
        count = len(self.surfaces_m)
        shapes = (self.surfaces_m.shape, self.lower.shape, self.upper.shape)
        if shapes != ((count, 2), (count, 2, 2), (count, 2, 2)):
            raise ValueError(f"must be (N, 2), (N, 2, 2), (N, 2, 2), got {shapes}")
        behind = (self.behind_m.shape, self.behind_surfaces_m.shape)
        further = len(self.behind_m)
        if behind != ((further, count), (further, count, 2)):
            raise ValueError(f"must be (K, N), (K, N, 2), got {behind}")
        arrays = (self.surfaces_m, self.lower, self.upper, self.behind_m, self.behind_surfaces_m)
        for array in arrays:
            read_only(array)

    def of(self, beams: BoolArray) -> Self:
        """Those of some of the beams."""
        return type(self)(
            surfaces_m=self.surfaces_m[beams],
            lower=self.lower[beams],
            upper=self.upper[beams],
            behind_m=self.behind_m[:, beams],
            behind_surfaces_m=self.behind_surfaces_m[:, beams],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VirtualScan(LaserScan):
    """A scan made of depth images. ``heights``: None where they are not known."""

    heights: BeamHeights | None = None

    def with_seam_at(self, beam: int) -> LaserScan:
        """The same full circle with its numbers counted from ``beam``, without the heights."""
        turned = LaserScan.with_seam_at(self, beam)
        if turned is self:
            return self
        assert isinstance(turned, VirtualScan)
        return replace(turned, heights=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageEdges:
    """The planes through a camera and the upper and the lower edge of its image.

    ``azimuth_rad``: where it looks. ``camera_m``: (3,). ``upper``, ``lower``: (3,) their normals.
    All in the scan's frame, heights above the floor.
    """

    azimuth_rad: float
    camera_m: FloatArray
    upper: FloatArray
    lower: FloatArray

    def __post_init__(self) -> None:
        for array in (self.camera_m, self.upper, self.lower):
            read_only(array)

    @classmethod
    def of(cls, intrinsics: CameraIntrinsics, T_floor_camera: FloatArray) -> Self:
        """Of an upright view; ``T_floor_camera``: (3, 4)."""
        R = T_floor_camera[:, :3]
        top, bottom = (
            (row - intrinsics.cy) / intrinsics.fy for row in (-0.5, intrinsics.height - 0.5)
        )
        # All rays (x, y, 1) of one row y are at right angles with (0, 1, -y).
        return cls(
            azimuth_rad=float(np.arctan2(R[1, 2], R[0, 2])),
            camera_m=T_floor_camera[:, 3].copy(),
            upper=R @ np.array([0.0, 1.0, -top]),
            lower=R @ np.array([0.0, 1.0, -bottom]),
        )


def seen_bands(
    cameras: Sequence[ImageEdges],
    azimuths_rad: FloatArray,
    *,
    lowest: tuple[float, float],
    highest_m: float,
) -> tuple[FloatArray, FloatArray]:
    """``lower`` and ``upper`` of ``BeamHeights`` for (N,) azimuths, each of the camera that looks
    there: between the image's edges, above ``lowest`` (height and rise) and below ``highest_m``."""
    lower = np.empty((azimuths_rad.size, 2, 2))
    upper = np.empty((azimuths_rad.size, 2, 2))
    lower[:, 0], upper[:, 0] = lowest, (highest_m, 0.0)
    aside_rad = np.stack(
        [np.abs(wrap_angle(azimuths_rad - camera.azimuth_rad)) for camera in cameras]
    )
    nearest = aside_rad.argmin(axis=0)
    for number, camera in enumerate(cameras):
        own = nearest == number
        lower[own, 1] = _edge_lines(camera.camera_m, camera.lower, azimuths_rad[own], -np.inf)
        upper[own, 1] = _edge_lines(camera.camera_m, camera.upper, azimuths_rad[own], np.inf)
    return lower, upper


def _edge_lines(
    camera_m: FloatArray, normal: FloatArray, azimuths_rad: FloatArray, unbounded_m: float
) -> FloatArray:
    """(N, 2) height at the scan's origin and rise per metre of a plane along azimuths."""
    if abs(normal[2]) < _VERTICAL * np.linalg.norm(normal):
        return np.tile([unbounded_m, 0.0], (azimuths_rad.size, 1))
    across = normal[:2] / normal[2]
    at_origin_m = camera_m[2] + across @ camera_m[:2]
    rise = -(across[0] * np.cos(azimuths_rad) + across[1] * np.sin(azimuths_rad))
    return np.stack([np.full(azimuths_rad.size, at_origin_m), rise], axis=1)
