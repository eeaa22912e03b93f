"""The cost that the mount minimises: how well it projects LiDAR points onto the depth images.

Disagreements differ in weight. A camera that sees *through* a LiDAR point (depth beyond it)
contradicts the mount; one that sees something *nearer* may just be occluded. A point above or below
the image says little, but must cost something: a large Delta z would otherwise move every near
point that could disagree out of the image. Points to the side of the image cost nothing.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fusion_core.alignment.mount_observation import MountObservation
from fusion_core.alignment.mount_settings import MountSettings
from fusion_core.compiled import compiled
from fusion_core.model.conventions import (
    NS_PER_S,
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
)
from fusion_core.model.geometry import invert_transform, transform_from_planar
from fusion_core.model.planar_poses import invert_pose, pose_after
from fusion_core.model.rig import Mount

MIN_POINTS = 100
"""From fewer LiDAR points nothing is concluded: an agreement of one half is then known to 10 % (two
standard deviations)."""

# A place along the curve: what one piece of furniture or of wall takes up.
_PLACE_RAD = float(np.deg2rad(5.0))

# Neighbouring frames see the same walls: they count as one observation.
_FRAMES_PER_BLOCK = 4
# The least depth of an Intel D435 at its lowest resolution, by its data sheet (105 mm), rounded.
_MIN_DEPTH_M = 0.1
# Within so many tolerances a point agrees with the depth: where the loss is about a half.
_AGREE_TOLERANCES = 2.5
# The loss 1 - exp(-(off / 2)^2 / 2) of Welsch with a scale of two tolerances.
_WELSCH = 0.125


class MountCost:
    """The kept frames as flat arrays, and the cost of a mount on each of them.

    ``max_range_m``: the longest measured range of the LiDAR. ``velocities``: (F, 3) of the LiDAR
    as those of ``ScanMotion``, 0 where a frame does not know it; ``turn_rate_sd_rad_s``: (F,).
    ``on_step`` is called before each mount that is tried, and may raise to end the search.
    """

    def __init__(
        self,
        frames: Sequence[MountObservation],
        settings: MountSettings,
        on_step: Callable[[], None] = lambda: None,
    ) -> None:
        self._frames = frames
        self._on_step = on_step
        self._settings = settings
        self.frames = len(frames)
        self.points = np.concatenate([frame.points_m for frame in frames])
        self.max_range_m = float(np.hypot(*self.points.T).max(initial=0.0))
        sizes = [frame.points_m.shape[0] for frame in frames]
        self.frame_of_point = np.repeat(np.arange(len(frames), dtype=np.int64), sizes)
        self._first_point = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        self._pixels = np.concatenate([frame.depth_m.ravel() for frame in frames])
        areas = [frame.depth_m.size for frame in frames]
        self._first_pixel = np.concatenate([[0], np.cumsum(areas)[:-1]]).astype(np.int64)
        self._intrinsics = np.array(
            [
                [
                    intrinsics.fx,
                    intrinsics.fy,
                    intrinsics.cx,
                    intrinsics.cy,
                    intrinsics.width,
                    intrinsics.height,
                ]
                for intrinsics in (frame.camera.intrinsics for frame in frames)
            ]
        )
        self.T_rig_camera = np.stack([frame.camera.T_rig_camera for frame in frames])
        self._T_camera_rig = np.stack([invert_transform(T) for T in self.T_rig_camera])
        motions = [frame.motion for frame in frames]
        self.velocities = np.array(
            [np.zeros(3) if motion is None else motion.velocity for motion in motions]
        )
        self.turn_rate_sd_rad_s = np.array(
            [0.0 if motion is None else motion.turn_rate_sd_rad_s for motion in motions]
        )
        self._image_after_points_s = np.array([frame.image_after_points_s for frame in frames])
        self.blocks = max(1, len(frames) // _FRAMES_PER_BLOCK)

    def subsampled(self) -> "MountCost":
        """The same cost over every third frame, for a wide search."""
        return MountCost(self._frames[::3], self._settings, self._on_step)

    def lowest_surface_m(self, pitch_rad: float = 0.0) -> float:
        """Height over the rig of the lowest surface that it sees under a pitch: the floor, where it
        is in the image; -inf where it sees none.

        A LiDAR plane below it would be nowhere in the images.
        """
        lowest = []
        up_in_rig = np.array([-np.sin(pitch_rad), 0.0, np.cos(pitch_rad)])
        for index, T_camera_rig in enumerate(self._T_camera_rig):
            fx, fy, cx, cy, width, height = self._intrinsics[index]
            first = self._first_pixel[index]
            depth = self._pixels[first : first + int(width * height)].reshape(int(height), -1)
            v, u = np.mgrid[0 : int(height) : 4, 0 : int(width) : 4]
            z = depth[::4, ::4]
            up = T_camera_rig[:3, :3] @ up_in_rig
            heights = z * ((u - cx) / fx * up[0] + (v - cy) / fy * up[1] + up[2])
            heights = heights[np.isfinite(heights)] - float(up @ T_camera_rig[:3, 3])
            if heights.size:
                lowest.append(np.quantile(heights, 0.01))
        return float(np.median(lowest)) if lowest else float("-inf")

    def tallies_per_frame(self, values: FloatArray) -> FloatArray:
        """(F, 5): cost, points in front of the camera, points on valid depth, points that agree,
        and points that something nearer may occlude."""
        return self.tallies_per_group(values, self.frame_of_point, self.frames)

    def tallies_per_group(self, values: FloatArray, group: IntArray, groups: int) -> FloatArray:
        """(groups, 5): the same for any groups of points, (N,) by their numbers; below 0 a point
        belongs to none."""
        mount = Mount.from_vector(values)
        T_camera_lidar = (
            self._T_camera_rig
            @ invert_transform(mount.T_lidar_rig)
            @ transform_from_planar(invert_pose(self.moved(mount)))
        )
        tallies: FloatArray = self._tallies(T_camera_lidar[np.newaxis], group, groups)[0]
        return tallies

    def costs_at_yaws(self, mount: Mount, yaws_rad: FloatArray) -> FloatArray:
        """(K,) cost of all frames for the mount at other yaws."""
        pitched = replace(mount, yaw_rad=0.0, forward_m=0.0, left_m=0.0, delta_z_m=0.0)
        back = np.eye(4)
        back[:3, 3] = -mount.T_lidar_rig[:3, 3]
        turns = np.zeros((yaws_rad.size, 3))
        turns[:, 2] = -yaws_rad
        T_rig_lidar = invert_transform(pitched.T_lidar_rig) @ transform_from_planar(turns) @ back
        T_image_scan = transform_from_planar(invert_pose(self.moved(mount)))
        T_camera_lidar = self._T_camera_rig @ T_rig_lidar[:, np.newaxis] @ T_image_scan
        tallies = self._tallies(T_camera_lidar, self.frame_of_point, self.frames)
        costs: FloatArray = tallies[:, :, 0].sum(axis=1)
        return costs

    @property
    def no_depth_cost(self) -> float:
        """Cost of a point above or below the image, or on a hole."""
        return self._settings.no_depth_cost

    def tolerance_at(self, range_m: FloatArray) -> FloatArray:
        """The agreement tolerance at ranges."""
        return self._settings.tolerance_m + self._settings.tolerance_fraction * range_m

    def moved(self, mount: Mount) -> FloatArray:
        """(F, 3) pose of the LiDAR at the image, whose stamp is late by the clock offset, in its
        frame at the points' stamp."""
        seconds = self._image_after_points_s - mount.clock_offset_ms * 1e-3
        return pose_after(self.velocities, seconds)

    def headings_rad(self) -> FloatArray:
        """(F,) heading of the LiDAR at each scan, from the first one's, by the turn rates."""
        seconds = np.array([frame.scan.stamp_ns for frame in self._frames]) / NS_PER_S
        order = np.argsort(seconds, kind="stable")
        rates = self.velocities[order, 2]
        turned = np.diff(seconds[order]) * 0.5 * (rates[1:] + rates[:-1])
        headings = np.empty(seconds.size)
        headings[order] = np.concatenate([[0.0], np.cumsum(turned)])
        return headings

    def places(self) -> IntArray:
        """(N,) of all points, by the turn rates, from the first frame on. A robot that drives sees
        a place move on slowly."""
        return places_of(self.headings_rad()[self.frame_of_point], self.points)

    def is_in_front(self, values: FloatArray) -> BoolArray:
        """(N,) whether a point lies between the left and the right of its image."""
        mount = Mount.from_vector(values)
        points_m = points_at_image(self.points, self.moved(mount)[self.frame_of_point])
        T_lidar_camera = mount.T_lidar_rig @ self.T_rig_camera
        return self._project(points_m, self.frame_of_point, T_lidar_camera)[0]

    def look_up(
        self, points_m: FloatArray, frame: IntArray, T_lidar_camera: FloatArray
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Which of the points (N, 2) of the LiDAR's plane, at their frame's image stamp, fall on a
        valid depth: their index (M,), the rays (M, 3) of their pixels at 1 m along the optical axis
        and the depths there (M,). ``T_lidar_camera``: (F, 4, 4)."""
        self._on_step()
        inside, column, row = self._project(points_m, frame, T_lidar_camera)
        inside &= (row >= 0) & (row < self._intrinsics[frame, 5])
        index = np.flatnonzero(inside)
        column, row, frame = column[index], row[index], frame[index]
        fx, fy, cx, cy, width, _ = self._intrinsics[frame].T
        flat = self._first_pixel[frame] + (row * width + column).astype(np.int64)
        seen_m = self._pixels[flat].astype(np.float64)
        rays = np.stack([(column - cx) / fx, (row - cy) / fy, np.ones(index.size)], axis=1)
        valid = np.isfinite(seen_m)
        return index[valid], rays[valid], seen_m[valid]

    def _project(
        self, points_m: FloatArray, frame: IntArray, T_lidar_camera: FloatArray
    ) -> tuple[BoolArray, FloatArray, FloatArray]:
        """(N,) whether points are between the left and the right of the image, and their pixels'
        columns and rows."""
        T_camera_lidar = np.array([invert_transform(T) for T in T_lidar_camera])[frame]
        x, y, depth = (
            T_camera_lidar[:, i, 0] * points_m[:, 0]
            + T_camera_lidar[:, i, 1] * points_m[:, 1]
            + T_camera_lidar[:, i, 3]
            for i in range(3)
        )
        fx, fy, cx, cy, width, _ = self._intrinsics[frame].T
        ahead = np.maximum(depth, _MIN_DEPTH_M)
        column, row = np.rint(cx + fx * x / ahead), np.rint(cy + fy * y / ahead)
        return (depth >= _MIN_DEPTH_M) & (column >= 0) & (column < width), column, row

    def _tallies(self, T_camera_lidar: FloatArray, group: IntArray, groups: int) -> FloatArray:
        """(K, groups, 5) under K mounts, (K, F, 4, 4)."""
        self._on_step()
        tallies: FloatArray = _tally_points(
            self.points,
            self._first_point,
            self._pixels,
            self._first_pixel,
            self._intrinsics,
            T_camera_lidar,
            group,
            groups,
            self._settings.tolerance_m,
            self._settings.tolerance_fraction,
            self._settings.occlusion_cost,
            self._settings.no_depth_cost,
        )
        return tallies

    def mean_cost(self, values: FloatArray) -> float:
        """Cost per point in front of a camera."""
        tallies = self.tallies_per_frame(values)
        return float(tallies[:, 0].sum() / max(tallies[:, 1].sum(), 1.0))

    def block_costs(self, values: FloatArray) -> FloatArray:
        """(blocks,) mean cost of runs of neighbouring frames."""
        tallies = self.tallies_per_frame(values)
        return np.array(
            [
                block[:, 0].sum() / max(block[:, 1].sum(), 1.0)
                for block in np.array_split(tallies, self.blocks)
            ]
        )

    def agreement_and_visibility(self, values: FloatArray) -> tuple[float, float]:
        """Fraction of the points on valid depth that agree, where one that something nearer may
        occlude counts as ``occlusion_cost`` of one that is contradicted; and fraction of the points
        in front of a camera that fall on valid depth."""
        totals = self.tallies_per_frame(values).sum(axis=0)
        return self.agreement_of(totals), float(totals[2] / max(totals[1], 1.0))

    def agreement_of(self, totals: FloatArray) -> float:
        """The first of these by the sums (5,) of a mount's tallies."""
        _, _, on_depth, agreeing, hidden = totals
        compared = on_depth - (1.0 - self._settings.occlusion_cost) * hidden
        return float(agreeing / max(compared, 1.0))


def places_of(headings_rad: FloatArray, points_m: FloatArray) -> IntArray:
    """(N,) the direction in the room of points (N, 2 or 3) that a robot sees at (N,) headings, in
    steps of 5 degrees."""
    azimuths_rad = headings_rad + np.arctan2(points_m[:, 1], points_m[:, 0])
    place: IntArray = np.floor(azimuths_rad / _PLACE_RAD).astype(np.int64)
    return place


def turn_points(vectors: FloatArray, angles_rad: FloatArray) -> FloatArray:
    """(N, 2) vectors, each turned by its angle."""
    cos, sin = np.cos(angles_rad), np.sin(angles_rad)
    x, y = vectors.T
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=1)


def points_at_image(points_m: FloatArray, moved: FloatArray) -> FloatArray:
    """(N, 2) points in the LiDAR's frame at the image, to which it ``moved`` (N, 3)."""
    return turn_points(points_m - moved[:, :2], -moved[:, 2])


@compiled()
def _tally_points(
    points: FloatArray,
    first_point: IntArray,
    pixels: Float32Array,
    first_pixel: IntArray,
    intrinsics: FloatArray,
    T_camera_lidar: FloatArray,
    group: IntArray,
    groups: int,
    tolerance_m: float,
    tolerance_fraction: float,
    occlusion_cost: float,
    no_depth_cost: float,
) -> FloatArray:
    """Under each of K mounts, per group of points (none below 0): cost, points in front, points on
    valid depth, points within 2.5 tolerances, points farther than those."""
    mounts, frames = T_camera_lidar.shape[:2]
    out = np.zeros((mounts, groups, 5))
    for k in range(mounts):
        for frame in range(frames):
            fx, fy, cx, cy, width, height = intrinsics[frame]
            T = T_camera_lidar[k, frame]
            for index in range(first_point[frame], first_point[frame + 1]):
                to = group[index]
                if to < 0:
                    continue
                x, y = points[index]
                depth = T[2, 0] * x + T[2, 1] * y + T[2, 3]
                if depth < _MIN_DEPTH_M:
                    continue
                u = cx + fx * (T[0, 0] * x + T[0, 1] * y + T[0, 3]) / depth
                if u < -0.5 or u >= width - 0.5:
                    continue
                v = cy + fy * (T[1, 0] * x + T[1, 1] * y + T[1, 3]) / depth
                out[k, to, 1] += 1.0
                if v < -0.5 or v >= height - 0.5:
                    out[k, to, 0] += no_depth_cost
                    continue
                column = int(np.floor(u + 0.5))
                row = int(np.floor(v + 0.5))
                seen = pixels[first_pixel[frame] + row * int(width) + column]
                if np.isnan(seen):
                    out[k, to, 0] += no_depth_cost
                    continue
                out[k, to, 2] += 1.0
                off = (seen - depth) / (tolerance_m + tolerance_fraction * depth)
                loss = 1.0 - np.exp(-_WELSCH * off * off)
                out[k, to, 0] += loss if off > 0.0 else occlusion_cost * loss
                if abs(off) < _AGREE_TOLERANCES:
                    out[k, to, 3] += 1.0
                elif off < 0.0:
                    out[k, to, 4] += 1.0
    return out
