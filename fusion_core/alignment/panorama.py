"""Several cameras side by side as one panorama, joined through their poses in 3D.

Each panorama sample is the nearest horizontal range, seen from the rig's origin, of the pixels
that fall on its azimuth and elevation: images are not pasted, so baselines between the cameras
shift near things as they must (up to 9 cm on Robot@Home's rig).
"""

from collections.abc import Sequence

import numpy as np

from fusion_core.alignment.curves import RowSampling, SamplingSettings
from fusion_core.model.conventions import Float32Array, FloatArray
from fusion_core.model.geometry import transform_points
from fusion_core.model.rig import Camera


class Panorama:
    """The fixed geometry of a rig's panorama: H rows of the first camera, W samples by azimuth.

    Row v is the elevation at which the first camera's row v looks straight ahead.
    """

    def __init__(self, cameras: Sequence[Camera], settings: SamplingSettings) -> None:
        self._cameras = tuple(cameras)
        step_rad = float(np.deg2rad(settings.step_deg))
        self._rays = []
        azimuths: list[float] = []
        for camera in self._cameras:
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
        intrinsics = self._cameras[0].intrinsics
        self._rows, self._focal, self._middle_row = intrinsics.height, intrinsics.fy, intrinsics.cy
        fov_rad = float(max(azimuths) - min(azimuths))
        count = max(2, int(fov_rad / step_rad))
        middle_rad = 0.5 * float(max(azimuths) + min(azimuths))
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
            self._cameras, self._rays, depths_m, strict=True
        ):
            points = transform_points(
                camera.T_rig_camera, depth_m[:, columns, np.newaxis].astype(np.float64) * rays
            )
            points = points[np.isfinite(depth_m[:, columns])]
            range_m = np.hypot(points[:, 0], points[:, 1])
            azimuth_rad = np.arctan2(points[:, 1], points[:, 0])
            sample = np.rint((self.sampling.left_rad - azimuth_rad) / self.sampling.step_rad)
            row = np.rint(self._middle_row - self._focal * points[:, 2] / range_m)
            inside = (sample >= 0) & (sample < count) & (row >= 0) & (row < self._rows)
            cell = (row[inside] * count + sample[inside]).astype(np.int64)
            np.minimum.at(nearest, cell, range_m[inside])
        return np.where(np.isfinite(nearest), nearest, np.nan).reshape(self._rows, count)
