"""A world of points with descriptors, and maps of it as a drifting tracker would leave them.

No image is rendered: a feature is a point's projection with noise, its descriptor with some bits
flipped. A tracker without loop closing is imitated: a keyframe sees landmarks of the few before it,
and where these no longer serve, new ones at the drifted place.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.geometry import invert_transform, make_transform, transform_points
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.slam.visual.frame_features import FrameFeatures
from fusion_core.slam.visual.keyframes import NO_LANDMARK
from fusion_core.slam.visual.relative_pose_refinement import small_motion
from fusion_core.slam.visual.visual_map import VisualMap

INTRINSICS = CameraIntrinsics(width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5)
# Keyframes whose landmarks the imitated tracker still knows.
LOCAL_KEYFRAMES = 6


@dataclass
class World:
    """``points_m``: (P, 3), z up. ``descriptors``: (P, 32)."""

    points_m: np.ndarray
    descriptors: np.ndarray

    def moved(self, by_m):
        return World(self.points_m + by_m, self.descriptors)

    def __add__(self, other):
        return World(
            np.concatenate([self.points_m, other.points_m]),
            np.concatenate([self.descriptors, other.descriptors]),
        )


def walls(rng, size_m, count, height_m=2.5):
    """Points on the four walls of a room about the origin."""
    length, width = size_m
    sides = rng.integers(4, size=count)
    along = rng.uniform(-0.5, 0.5, count)
    x = np.where(sides < 2, along * length, np.where(sides == 2, 0.5, -0.5) * length)
    y = np.where(sides >= 2, along * width, np.where(sides == 0, 0.5, -0.5) * width)
    points = np.column_stack([x, y, rng.uniform(0.0, height_m, count)])
    return World(points, rng.integers(256, size=(count, 32), dtype=np.uint8))


def camera_pose(x, y, heading_rad, z=1.2):
    """T_world_camera of a level camera."""
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    # Columns: right, down, ahead.
    R = np.array([[s, 0.0, c], [-c, 0.0, s], [0.0, -1.0, 0.0]])
    return make_transform(R, np.array([x, y, z]))


def observe(world, T_world_camera, rng, *, range_max_m=8.0, pixel_sigma=0.5, flips=12):
    """The features of a view, and (F,) the points that they are of."""
    points = transform_points(invert_transform(T_world_camera), world.points_m)
    z = points[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = INTRINSICS.fx * points[:, 0] / z + INTRINSICS.cx
        v = INTRINSICS.fy * points[:, 1] / z + INTRINSICS.cy
    seen = np.flatnonzero(
        (z > 0.3) & (z < range_max_m) & (u >= 0) & (u <= 639) & (v >= 0) & (v <= 479)
    )
    rng.shuffle(seen)
    seen = seen[:500]
    count = len(seen)
    bits = np.zeros((count, 256), np.uint8)
    rows = np.repeat(np.arange(count), flips)
    bits[rows, rng.integers(256, size=rows.size)] = 1
    inverse_depth = 1.0 / z[seen] + rng.normal(0.0, 0.0015, count)
    features = FrameFeatures(
        pixels=np.column_stack([u[seen], v[seen]]) + rng.normal(0.0, pixel_sigma, (count, 2)),
        depths_m=np.where(rng.random(count) < 0.1, np.nan, 1.0 / inverse_depth),
        octaves=np.zeros(count, np.int64),
        angles_deg=np.zeros(count, np.float32),
        descriptors=world.descriptors[seen] ^ np.packbits(bits, axis=1),
    )
    return features, seen


class DriftingTracker:
    """Adds keyframes to a map at drifted poses.

    ``drift``: (6,) of each step, rotation vector and translation, in the camera's frame.
    """

    def __init__(self, world, seed, drift=(0.0,) * 6, **noise):
        self.map = VisualMap()
        self.truth = []
        self._world, self._rng = world, np.random.default_rng(seed)
        self._drift, self._noise = np.asarray(drift), noise
        # Of each keyframe: the landmark by the world's point.
        self._landmarks = []
        self._stamp_ns, self._T_map_next = 0, None

    def add(self, T_world_camera):
        features, points = observe(self._world, T_world_camera, self._rng, **self._noise)
        T_map_camera = T_world_camera
        is_lost = not self._landmarks
        if self._T_map_next is not None:
            T_map_camera, self._T_map_next = self._T_map_next, None
        elif self.truth:
            step = invert_transform(self.truth[-1]) @ T_world_camera
            last = self.map.keyframes[-1].T_map_camera
            T_map_camera = last @ step @ small_motion(self._drift)
        self.truth.append(T_world_camera)
        known = {}
        for landmarks in self._landmarks[-LOCAL_KEYFRAMES:]:
            known.update(landmarks)
        rows = np.array([known.get(p, NO_LANDMARK) for p in points.tolist()], dtype=np.int64)
        is_new = (rows == NO_LANDMARK) & np.isfinite(features.depths_m)
        u, v = features.pixels[is_new].T
        z = features.depths_m[is_new]
        x = (u - INTRINSICS.cx) / INTRINSICS.fx * z
        y = (v - INTRINSICS.cy) / INTRINSICS.fy * z
        rows[is_new] = self.map.add_landmarks(
            transform_points(T_map_camera, np.column_stack([x, y, z])), features.descriptors[is_new]
        )
        # One landmark may have been merged away since.
        rows = np.where((rows >= 0) & self.map.is_landmark_culled[rows], NO_LANDMARK, rows)
        parent = None if is_lost else len(self.map.keyframes) - 1
        self._stamp_ns += 10**9
        keyframe = self.map.add_keyframe(self._stamp_ns, features, T_map_camera, rows, parent)
        self._landmarks.append(
            {p: r for p, r in zip(points.tolist(), rows.tolist(), strict=True) if r >= 0}
        )
        return keyframe.index

    def forget_landmarks(self, pause_ns, T_map_next=None):
        """Lose the camera: the next keyframe, after a pause, starts a map of its own."""
        self._landmarks.clear()
        self._stamp_ns += pause_ns - 10**9
        self._T_map_next = T_map_next

    def errors_m(self):
        """(K,) distances of the keyframes from where they are, the first laid on its truth."""
        T_world_map = self.truth[0] @ invert_transform(self.map.keyframes[0].T_map_camera)
        return np.array(
            [
                np.linalg.norm((T_world_map @ self.map.pose_of(i))[:3, 3] - T[:3, 3])
                for i, T in enumerate(self.truth)
            ]
        )


def round_trip(count=60, radius_m=4.0, turns=1.15):
    """Poses on a circle, looking outwards, past the start."""
    angles = np.linspace(0.0, 2.0 * np.pi * turns, count)
    return [camera_pose(radius_m * np.cos(a), radius_m * np.sin(a), a) for a in angles]


def hall(seed=1):
    """A hall for ``round_trip``."""
    return walls(np.random.default_rng(seed), (14.0, 13.0), 9000)


def two_rooms(seed=1, apart_m=6.0):
    """Two rooms that are the same, and a corridor between; what is farther than 3 m is hidden."""
    rng = np.random.default_rng(seed)
    room = walls(rng, (4.0, 4.0), 2500)
    # No point of the room's stands in the corridor's way.
    corridor = walls(rng, (apart_m, 1.5), 1500).moved([0.5 * apart_m, 0.0, 0.0])
    return room + corridor + room.moved([apart_m, 0.0, 0.0])


def rooms_trip(apart_m=6.0):
    """A round in the first room, the way to the second, a round in it."""
    turns = np.linspace(0.0, 2.0 * np.pi, 25)
    first = [camera_pose(0.3 * np.cos(a), 0.3 * np.sin(a), a) for a in turns]
    way = [camera_pose(x, 0.0, 0.0) for x in np.linspace(0.5, apart_m, 12)]
    second = [camera_pose(apart_m + 0.3 * np.cos(a), 0.3 * np.sin(a), a) for a in turns]
    return first, way, second
