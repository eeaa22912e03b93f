"""RGB-D frames of the inside of a coloured sphere, in closed form."""

import numpy as np

from fusion_core.lens.undistortion import undistort_pixels
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics

RADIUS_M = 1.2
INTRINSICS = CameraIntrinsics(
    width=80, height=60, fx=60.0, fy=62.0, cx=38.7, cy=30.9, distortion=(-0.2, 0.05, 0.002, -0.001)
)


def color_of(points_m):
    """(N, 3) the colour of points on the sphere: it varies slowly."""
    return np.rint(255.0 * (0.5 + 0.4 * np.asarray(points_m) / RADIUS_M)).astype(np.uint8)


def poses(count):
    for i in range(count):
        yield make_transform(
            rotation_from_yaw_pitch_roll(0.8 * i, 0.2 * i, -1.4 + 0.1 * i),
            np.array([0.05 * i, -0.04 * i, 0.03 * i]),
        )


class SphereViews:
    """Keyframes with their poses, iterable any number of times."""

    def __init__(self, count, intrinsics=INTRINSICS, depth_shape=None):
        self.count, self.intrinsics = count, intrinsics
        self.passes = 0

    def __len__(self):
        return self.count

    def __iter__(self):
        self.passes += 1
        for i, T_map_camera in enumerate(poses(self.count)):
            depth_m, rgb = self.images(T_map_camera)
            gray = rgb.mean(axis=2).astype(np.uint8)
            yield RgbdFrame(stamp_ns=i, gray=gray, depth_m=depth_m, rgb=rgb), T_map_camera

    def images(self, T_map_camera):
        """Where each pixel's ray leaves the sphere around the map's origin."""
        height, width = self.intrinsics.height, self.intrinsics.width
        v, u = np.mgrid[:height, :width].astype(np.float64)
        rays = undistort_pixels(np.column_stack([u.ravel(), v.ravel()]), self.intrinsics)
        rays = np.column_stack([rays, np.ones(len(rays))]) @ T_map_camera[:3, :3].T
        origin_m = T_map_camera[:3, 3]
        a, b = (rays**2).sum(axis=1), rays @ origin_m
        z_m = (-b + np.sqrt(b**2 - a * (origin_m @ origin_m - RADIUS_M**2))) / a
        rgb = color_of(origin_m + z_m[:, np.newaxis] * rays)
        return z_m.reshape(height, width).astype(np.float32), rgb.reshape(height, width, 3)
