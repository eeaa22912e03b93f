"""A room of axis-aligned boxes, in which every distance has a closed form."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.model.sensors import CameraIntrinsics, LaserScan

OPTICAL = rotation_from_yaw_pitch_roll(-np.pi / 2, 0.0, -np.pi / 2)
INTRINSICS = CameraIntrinsics(width=320, height=240, fx=288.0, fy=288.0, cx=159.5, cy=119.5)
LIDAR_HEIGHT_M = 0.3


def camera_pose(height_m=0.8, *, x=0.05, y=0.03, yaw=0.1, pitch=0.0, roll=0.0):
    """(4, 4) T_base_camera of a camera over the floor at the robot's base."""
    rotation = rotation_from_yaw_pitch_roll(yaw, pitch, roll) @ OPTICAL
    return make_transform(rotation, np.array([x, y, height_m]))


@dataclass(frozen=True)
class BoxRoom:
    """``size_m``: x, y, z of the room, whose floor is z = 0; ``boxes``: (B, 6) low and high."""

    size_m: tuple[float, float, float] = (6.0, 5.0, 2.5)
    boxes: tuple[tuple[float, ...], ...] = ()

    def distances(self, origin_m, directions):
        """(N,) how many times each direction (N, 3) reaches to the first surface."""
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (np.where(directions > 0, self.size_m, 0.0) - origin_m) / directions
            best = np.nanmin(np.where(t > 0, t, np.inf), axis=1)
            for box in self.boxes:
                low, high = (np.array(box[:3]) - origin_m), (np.array(box[3:]) - origin_m)
                a, b = low / directions, high / directions
                enter = np.nanmax(np.minimum(a, b), axis=1)
                leave = np.nanmin(np.maximum(a, b), axis=1)
                met = (enter <= leave) & (enter > 0)
                best = np.where(met, np.minimum(best, enter), best)
        return best

    def scan(self, pose, *, beams=360, range_max_m=10.0, stamp_ns=0, height_m=LIDAR_HEIGHT_M):
        """The exact sweep of a LiDAR at ``pose`` (x, y, yaw)."""
        increment = 2 * np.pi / beams
        azimuth = pose[2] - np.pi + increment * np.arange(beams)
        directions = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(beams)], axis=1)
        ranges = self.distances(np.array([pose[0], pose[1], height_m]), directions)
        return LaserScan(
            stamp_ns=stamp_ns,
            received_ns=stamp_ns,
            frame_id="laser",
            angle_min_rad=-np.pi,
            angle_increment_rad=increment,
            range_min_m=0.05,
            range_max_m=range_max_m,
            ranges_m=np.where(ranges <= range_max_m, ranges, np.nan),
        )

    def depth(self, pose, T_base_camera, *, intrinsics=INTRINSICS, noise=None):
        """(H, W) depth image; ``noise``: a generator for a Kinect's standard deviation."""
        base = make_transform(
            rotation_from_yaw_pitch_roll(pose[2], 0.0, 0.0), np.array([pose[0], pose[1], 0.0])
        )
        T = base @ T_base_camera
        v, u = np.mgrid[: intrinsics.height, : intrinsics.width]
        rays = np.stack(
            [
                (u - intrinsics.cx) / intrinsics.fx,
                (v - intrinsics.cy) / intrinsics.fy,
                np.ones(u.shape),
            ],
            axis=-1,
        ).reshape(-1, 3)
        depth = self.distances(T[:3, 3], rays @ T[:3, :3].T)
        if noise is not None:
            depth = depth + 1.4e-3 * depth**2 * noise.standard_normal(depth.size)
        return depth.reshape(u.shape).astype(np.float32)

    def nearest_in_band(self, pose, azimuth, low_m, high_m):
        """(N,) range of the first obstacle between two heights, whichever its height."""
        directions = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(azimuth.size)], axis=1)
        kept = tuple(
            (*box[:2], -1.0, *box[3:5], 9.0)
            for box in self.boxes
            if box[5] > low_m and box[2] < high_m
        )
        room = BoxRoom(self.size_m, kept)
        return room.distances(np.array([pose[0], pose[1], 0.5 * (low_m + high_m)]), directions)
