"""Several cameras side by side as one panorama: joined in 3D, or pasted as the paper does.

``Panorama``: each sample is the nearest horizontal range, seen from the rig's origin, of the
pixels that fall on its azimuth and elevation, so baselines between the cameras shift near things as
they must (up to 9 cm on Robot@Home's rig).

``PastedPanorama`` (Xu 2024 §3.2): the images beside each other as one wide image, 960 x 320 on the
paper's rig, of which each pixel is still a pixel of one camera.
"""

from collections.abc import Sequence

import numpy as np

from fusion_core.alignment.curves import RowSampling, SamplingSettings, row_samples_m
from fusion_core.model.conventions import Float32Array, FloatArray, IntArray
from fusion_core.model.geometry import transform_points
from fusion_core.model.polar import unwrap_towards
from fusion_core.model.rig import Camera

# Between two neighbours at most this fraction of an image may be unseen: with more, a row of
# samples has more gap than image in it.
_WIDEST_GAP = 0.5


def are_side_by_side(cameras: Sequence[Camera]) -> bool:
    """Whether several cameras look next to each other, so that their images, of one height, make a
    panorama."""
    if len(cameras) < 2 or len({camera.intrinsics.height for camera in cameras}) > 1:
        return False
    heading_rad = _headings_rad(cameras)
    fov_rad = np.array([_fov_rad(camera) for camera in cameras])
    order = _order_from_left(cameras)
    step_rad = -np.diff(heading_rad[order])
    seen_rad = 0.5 * (fov_rad[order][:-1] + fov_rad[order][1:])
    # Two images of one direction are no panorama either: each shows most of the other.
    return bool(
        (step_rad - seen_rad <= _WIDEST_GAP * seen_rad).all()
        and (seen_rad - step_rad <= _WIDEST_GAP * seen_rad).all()
    )


def _order_from_left(cameras: Sequence[Camera]) -> list[int]:
    """Numbers of cameras that are side by side, leftmost first."""
    return [int(index) for index in np.argsort(-_headings_rad(cameras), kind="stable")]


def _headings_rad(cameras: Sequence[Camera]) -> FloatArray:
    """(C,) azimuths of the optical axes in the rig frame, continuous across the rig's back."""
    yaw_rad = np.array([camera.yaw_rad for camera in cameras])
    middle_rad = float(np.angle(np.exp(1j * yaw_rad).sum()))
    headings: FloatArray = middle_rad + np.angle(np.exp(1j * (yaw_rad - middle_rad)))
    return headings


def _fov_rad(camera: Camera) -> float:
    edges = camera.column_azimuths_rad(np.array([-0.5, camera.intrinsics.width - 0.5]))
    return float(edges[0] - edges[1])


class PastedPanorama:
    """The upright images of a rig beside each other, leftmost first, as one (H, sum of W') image.

    The cameras must be side by side. ``columns_of``: for each camera, the columns of the wide image
    that are its own.
    """

    def __init__(self, cameras: Sequence[Camera], settings: SamplingSettings) -> None:
        self.cameras = tuple(cameras)
        self.settings = settings
        heading_rad = _headings_rad(cameras)
        self._order = _order_from_left(cameras)
        self.from_left = tuple(cameras[index] for index in self._order)
        first = 0
        self.columns_of = [range(0)] * len(cameras)
        for index in self._order:
            width = cameras[index].intrinsics.width
            self.columns_of[index] = range(first, first + width)
            first += width
        step_rad = float(np.deg2rad(settings.step_deg))
        # One sample a step from heading to heading: 4 images 45 degrees apart have W = 180 of 960
        # columns, and the samples keep pace with the LiDAR's.
        mean_step_rad = float(np.ptp(heading_rad)) / (len(cameras) - 1)
        count = max(2, round(len(cameras) * mean_step_rad / step_rad))
        left_rad = float(heading_rad.mean()) + 0.5 * (count - 1) * step_rad
        columns = np.rint(np.linspace(0.0, first - 1.0, count)).astype(np.int64)
        range_per_depth = np.ones(count)
        if settings.by == "angle":
            # The camera that looks most nearly there gives the sample.
            azimuth_rad = left_rad - step_rad * np.arange(count)
            nearest = np.abs(azimuth_rad - heading_rad[:, np.newaxis]).argmin(axis=0)
            for index, camera in enumerate(cameras):
                own, intrinsics = nearest == index, camera.intrinsics
                off_axis_rad = azimuth_rad[own] - heading_rad[index]
                column = np.rint(intrinsics.cx - intrinsics.fx * np.tan(off_axis_rad))
                inside = np.clip(column.astype(np.int64), 0, intrinsics.width - 1)
                columns[own] = self.columns_of[index][0] + inside
                range_per_depth[own] = 1.0 / np.cos(off_axis_rad)
        self.sampling = RowSampling(
            columns=columns, left_rad=left_rad, step_rad=step_rad, range_per_depth=range_per_depth
        )

    def paste(self, depths_m: Sequence[Float32Array]) -> Float32Array:
        """The wide image of one upright (H, W') image for each camera."""
        return np.hstack([depths_m[index] for index in self._order])

    def samples_m(self, depths_m: Sequence[Float32Array]) -> FloatArray:
        """(H, W) samples as they are taken from a single image's rows."""
        return row_samples_m(self.paste(depths_m), self.sampling)

    def camera_of(self, columns: IntArray) -> IntArray:
        """Which camera's pixel a column of the wide image is."""
        starts = np.array([self.columns_of[index][0] for index in self._order])
        return np.array(self._order)[np.searchsorted(starts, columns, side="right") - 1]


class Panorama:
    """The fixed geometry of a rig's panorama: H rows of the first camera, W samples by azimuth.

    Row v is the elevation at which the first camera's row v looks straight ahead.
    """

    def __init__(self, cameras: Sequence[Camera], settings: SamplingSettings) -> None:
        self.cameras = tuple(cameras)
        self.from_left = tuple(cameras[index] for index in _order_from_left(cameras))
        self.settings = settings
        step_rad = float(np.deg2rad(settings.step_deg))
        self._rays = []
        azimuths: list[float] = []
        for camera in self.cameras:
            # Columns half a sample apart give at least one value a sample.
            intrinsics = camera.intrinsics
            stride = max(1, int(0.5 * step_rad * intrinsics.fx))
            columns = np.arange(0, intrinsics.width, stride)
            u, v = np.meshgrid(columns, np.arange(intrinsics.height))
            rays = camera.rays(v, u)
            self._rays.append((columns, rays))
            ends = transform_points(
                camera.T_rig_camera, 2.0 * rays[intrinsics.height // 2, [0, -1]]
            )
            azimuths.extend(np.arctan2(ends[:, 1], ends[:, 0]))
        intrinsics = self.cameras[0].intrinsics
        self._rows, self._focal, self._middle_row = intrinsics.height, intrinsics.fy, intrinsics.cy
        # A rig may look across the back of its frame, where azimuths change their sign.
        heading_rad = float(_headings_rad(cameras).mean())
        ends_rad = unwrap_towards(np.array(azimuths), heading_rad)
        fov_rad = float(ends_rad.max() - ends_rad.min())
        count = max(2, int(fov_rad / step_rad))
        middle_rad = 0.5 * float(ends_rad.max() + ends_rad.min())
        self.sampling = RowSampling(
            columns=np.arange(count, dtype=np.int64),
            left_rad=middle_rad + 0.5 * (count - 1) * step_rad,
            step_rad=step_rad,
            range_per_depth=np.ones(count),
        )

    def samples_m(self, depths_m: Sequence[Float32Array]) -> FloatArray:
        """(H, W) horizontal ranges from the rig's origin, NaN where no camera sees anything.

        ``depths_m``: one (H, W) depth image for each camera, of nearly the same instant.
        """
        count = self.sampling.columns.size
        nearest = np.full(self._rows * count, np.inf)
        for camera, (columns, rays), depth_m in zip(
            self.cameras, self._rays, depths_m, strict=True
        ):
            points = transform_points(
                camera.T_rig_camera, depth_m[:, columns, np.newaxis].astype(np.float64) * rays
            )
            points = points[np.isfinite(depth_m[:, columns])]
            range_m = np.hypot(points[:, 0], points[:, 1])
            azimuth_rad = np.arctan2(points[:, 1], points[:, 0])
            sample = np.rint(self.sampling.from_left_rad(azimuth_rad) / self.sampling.step_rad)
            row = np.rint(self._middle_row - self._focal * points[:, 2] / range_m)
            inside = (sample >= 0) & (sample < count) & (row >= 0) & (row < self._rows)
            cell = (row[inside] * count + sample[inside]).astype(np.int64)
            np.minimum.at(nearest, cell, range_m[inside])
        return np.where(np.isfinite(nearest), nearest, np.nan).reshape(self._rows, count)
