"""What a depth image and its scan are to each other: offset, pairs and the transform A."""

from dataclasses import dataclass, replace

import numpy as np

from fusion_core.alignment.curves import (
    CurveSampling,
    RowSampling,
)
from fusion_core.alignment.panorama import PastedPanorama
from fusion_core.alignment.scan_motion import ScanMotion
from fusion_core.denoising.correspondence import (
    Correspondence,
    RowModel,
)
from fusion_core.model.conventions import Float32Array, FloatArray, IntArray, read_only
from fusion_core.model.robust import robust_sigma
from fusion_core.model.sensors import LaserScan
from fusion_core.registration.ransac import Registration
from fusion_core.workflows.fuse.offset_search import OffsetSearch
from fusion_core.workflows.fuse.pairing import FramePair, UprightDepth


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PastedPairs:
    """The pairs of a pasted panorama.

    ``depth_m``: (H, W) its wide image, in which the pairs' columns count; ``previous``: that of the
    images before, None where one is missing. ``camera``: (B,) whose pixel a pair has. ``images``:
    the pairs that were pasted, one of each camera.
    """

    panorama: PastedPanorama
    images: tuple[FramePair, ...]
    depth_m: Float32Array
    previous: UprightDepth | None
    correspondence: Correspondence
    camera: IntArray

    def __post_init__(self) -> None:
        read_only(self.depth_m)
        read_only(self.camera)

    def part_of(self, camera: int) -> Correspondence:
        """A camera's own pairs, with the columns of its image."""
        own = self.camera == camera
        pairs = self.correspondence.subset(own)
        return replace(pairs, column=pairs.column - self.panorama.columns_of[camera][0])


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameMatch:
    """A depth image matched with its scan: the results of all stages before classification.

    ``curve`` and ``row`` sample the fields of ``search``. Where several cameras look side by side,
    these are of the panorama of the images of nearly the same instant, and all of them share them.
    ``registration`` is None where it failed, for the reason in ``refusal``.
    ``u_of_rig``: added to a peak's u, it gives the u of the recording's field; not 0 where an image
    of several cameras is searched by itself.
    ``moved``: (3,) pose of the LiDAR at the image in its frame at the scan, by which the pairs were
    corrected. ``motion``: of the LiDAR, None where it cannot be estimated from its scans.
    ``images``: how many were searched together.
    ``pasted``: the panorama whose samples were paired and registered, of which ``correspondence``
    is this image's part; None where the image was paired by itself.
    """

    pair: FramePair
    moved: FloatArray
    motion: ScanMotion | None
    curve: CurveSampling
    row: RowSampling
    search: OffsetSearch
    u_of_rig: float
    row_model: RowModel
    registration: Registration | None
    refusal: str
    correspondence: Correspondence
    images: int = 1
    pasted: PastedPairs | None = None

    @property
    def scan(self) -> LaserScan:
        """The scan that the image is paired with."""
        return self.pair.scan

    @property
    def stamp_ns(self) -> int:
        """The image's stamp."""
        return self.pair.image.stamp_ns

    @property
    def depth_m(self) -> Float32Array:
        """(H', W') upright view of the image."""
        return self.pair.depth_m

    @property
    def sigma_m(self) -> float:
        """Robust standard deviation of the residuals about zero, NaN without pairs."""
        residual_m = self.correspondence.residual_m
        residual_m = residual_m[np.isfinite(residual_m)]
        return robust_sigma(residual_m) if residual_m.size else float("nan")


def curves_at(
    match: FrameMatch, offset: tuple[float, float], *, masked: bool = True
) -> tuple[FloatArray, FloatArray]:
    """(W,) samples of the LiDAR's curve and of the depth row that are compared at an offset (u, v)
    of the row that was searched. ``masked``: holes are NaN, else 0."""
    rows_m, curve_m = match.search.rows_m, match.search.curve_m
    depth_m = rows_m[int(np.clip(round(offset[1]), 0, rows_m.shape[0] - 1))].copy()
    index = round(offset[0]) + np.arange(depth_m.size)
    inside = (index >= 0) & (index < curve_m.size)
    lidar_m = np.full(depth_m.size, np.nan)
    lidar_m[inside] = curve_m[index[inside]]
    if not masked:
        depth_m = np.nan_to_num(depth_m, nan=0.0)
        lidar_m[inside] = np.nan_to_num(lidar_m[inside], nan=0.0)
    return lidar_m, depth_m
