"""Replaces ``build_map`` for visual SLAM: known poses, real features, and the files of a run."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fusion_core.exporting.clouds import write_cloud
from fusion_core.exporting.tum_trajectory import write_tum_trajectory
from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray, IntArray
from fusion_core.model.geometry import transform_points
from fusion_core.model.progress import Progress
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.model.slam_view import SlamObserver, no_observer
from fusion_core.model.trajectory import Trajectory
from fusion_core.model.visual_slam_view import VisualSlamObserver, VisualSlamView, unobserved
from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.map.options import MapOptions
from fusion_core.workflows.map.report import MapSummary
from fusion_core.workflows.map.rgbd_frames import RgbdFrames
from fusion_core.workflows.source import open_source

EVERY = 10
LOOP = (1, 3)
# Of the colours of a keyframe's depth pixels, each so many-th.
_STRIDE = 3
_FEATURES = 400


def seven_scenes_poses(folder: Path) -> Callable[[int], FloatArray]:
    """The given poses, in a map with z up: the scene's own has y down."""
    up = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 0], [0, 0, 0, 1.0]])
    files = sorted(folder.glob("*.pose.txt"))
    return lambda number: up @ np.loadtxt(files[number])


def forward(number: int) -> FloatArray:
    """A camera that looks along the map's x axis, a centimetre further on in each image."""
    T_map_camera = np.eye(4)
    T_map_camera[:3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    T_map_camera[0, 3] = 0.01 * number
    return T_map_camera


class FakeVisualMap:
    """``build_map`` with ``pose(number)`` of each image, (4, 4); each call gets an
    ``at_keyframe(number)`` to wait in, or to fail in. ``within_m``: so near to each other features
    that look alike are one landmark."""

    def __init__(self, pose: Callable[[int], FloatArray], within_m: float = 0.05) -> None:
        self.pose, self.within_m = pose, within_m
        self.at_keyframe: Callable[[int], None] = lambda number: None

    def __call__(
        self,
        recording: Path,
        output: Path,
        options: MapOptions,
        progress: Progress,
        observer: SlamObserver = no_observer,
        visual_observer: VisualSlamObserver = unobserved,
    ) -> MapSummary:
        growing = _GrowingMap(self.within_m)
        with open_source(recording, None) as opened:
            frames = RgbdFrames(opened, choose_streams(opened, lidar=None, depth=None))
            for number, frame in enumerate(frames):
                progress(number + 1, None, "tracking the camera")
                growing.add(frame, frames.intrinsics, self.pose(number))
                if number % EVERY == 0:
                    self.at_keyframe(number // EVERY)
                    visual_observer(growing.view())
        report = growing.write(output)
        return MapSummary(output=output, is_skipped=False, report=report, seconds={"track": 1.5})


class _GrowingMap:
    def __init__(self, within_m: float) -> None:
        self.within_m = within_m
        self.stamps_ns: list[int] = []
        self.poses: list[FloatArray] = []
        self.keyframes: list[int] = []
        self.pixels: list[Float32Array] = []
        self.landmarks: list[IntArray] = []
        self.descriptors: list[ByteArray] = []
        self.points_m: list[FloatArray] = []
        self.rgb: list[ByteArray] = []
        self.landmarks_m: list[FloatArray] = []

    @property
    def loops(self) -> IntArray:
        has_loop = len(self.keyframes) > max(LOOP) + 1
        return np.array([LOOP] if has_loop else [], dtype=np.int64).reshape(-1, 2)

    def add(self, frame: RgbdFrame, camera: CameraIntrinsics, pose: FloatArray) -> None:
        if len(self.poses) % EVERY == 0:
            self._add_keyframe(frame, camera, pose)
        self.stamps_ns.append(frame.stamp_ns)
        self.poses.append(pose)

    def _add_keyframe(self, frame: RgbdFrame, camera: CameraIntrinsics, pose: FloatArray) -> None:
        self.keyframes.append(len(self.poses))
        found, descriptors = cv2.ORB_create(_FEATURES).detectAndCompute(frame.gray, None)
        pixels = np.array([one.pt for one in found], dtype=np.float32)
        columns, rows = np.rint(pixels).astype(int).T
        depth_m = frame.depth_m[rows, columns].astype(np.float64)
        in_map = transform_points(pose, _rays(pixels, camera) * depth_m[:, np.newaxis])
        landmarks = np.full(len(pixels), -1, dtype=np.int64)
        if self.descriptors:
            matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(
                descriptors, self.descriptors[-1]
            )
            for match in matches:
                known = self.landmarks[-1][match.trainIdx]
                away_m = np.linalg.norm(self.landmarks_m[known] - in_map[match.queryIdx])
                if known >= 0 and away_m < self.within_m:
                    landmarks[match.queryIdx] = known
        for index in np.flatnonzero((landmarks < 0) & np.isfinite(depth_m)):
            landmarks[index] = len(self.landmarks_m)
            self.landmarks_m.append(in_map[index])
        self.pixels.append(pixels)
        self.landmarks.append(landmarks)
        self.descriptors.append(descriptors)
        height, width = frame.depth_m.shape
        v, u = np.mgrid[0:height:_STRIDE, 0:width:_STRIDE].reshape(2, -1)
        depth_m = frame.depth_m[v, u].astype(np.float64)
        known = np.isfinite(depth_m)
        rays = _rays(np.stack([u, v], axis=1).astype(np.float32), camera)
        self.points_m.append(transform_points(pose, (rays * depth_m[:, np.newaxis])[known]))
        assert frame.rgb is not None
        self.rgb.append(frame.rgb[v, u][known])

    def view(self) -> VisualSlamView:
        return VisualSlamView(
            stage="tracking",
            stamps_ns=np.array(self.stamps_ns, dtype=np.int64),
            T_map_camera=np.array(self.poses),
            keyframe_stamps_ns=np.array([self.stamps_ns[k] for k in self.keyframes]),
            T_map_keyframe=np.array([self.poses[k] for k in self.keyframes]),
            loops=self.loops,
            points_in_map_m=np.concatenate(self.points_m).astype(np.float32),
            rgb=np.concatenate(self.rgb),
        )

    def write(self, output: Path) -> dict[str, Any]:
        output.mkdir(parents=True)
        view = self.view()
        trajectory = Trajectory(stamps_ns=view.stamps_ns.copy(), T_map_body=view.T_map_camera)
        write_tum_trajectory(output / "trajectory.tum", trajectory)
        np.savez(
            output / "visual_map.npz",
            stamps_ns=view.keyframe_stamps_ns,
            T_map_camera=view.T_map_keyframe,
            offsets=np.cumsum([0, *map(len, self.pixels)]),
            pixels=np.concatenate(self.pixels),
            landmarks=np.concatenate(self.landmarks),
            landmarks_in_map_m=np.array(self.landmarks_m),
            loops=view.loops,
            loop_inliers=np.full(len(view.loops), 57),
        )
        write_cloud(output / "cloud.ply", view.points_in_map_m.astype(np.float64), view.rgb)
        stamps_s = view.stamps_ns / 1e9
        report = {
            "slam": "visual",
            "scan": "camera",
            "lost": [
                {
                    "from_s": stamps_s[3],
                    "to_s": stamps_s[5],
                    "images": 3,
                    "reason": "too few matches",
                }
            ],
            "jumps": [{"from_s": stamps_s[5], "to_s": stamps_s[6], "step_m": 0.61}],
            "notes": ["The floor is not in sight.", "<b>& more"],
        }
        (output / "report.json").write_text(json.dumps(report), encoding="utf-8")
        return report


def _rays(pixels: Float32Array, camera: CameraIntrinsics) -> FloatArray:
    return np.column_stack(
        [
            (pixels[:, 0] - camera.cx) / camera.fx,
            (pixels[:, 1] - camera.cy) / camera.fy,
            np.ones(len(pixels)),
        ]
    )
