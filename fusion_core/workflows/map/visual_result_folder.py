"""What a run of visual SLAM wrote beside its report: keyframes, what they see, and the cloud."""

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.evaluation.truth_arrays import UNREADABLE_ARRAYS, read_arrays
from fusion_core.exporting.manifest import require_intact
from fusion_core.model.conventions import (
    NS_PER_MS,
    NS_PER_S,
    R_BODY_OPTICAL,
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
    read_only,
)
from fusion_core.model.errors import ExportError, ScanLoomError
from fusion_core.model.geometry import invert_transform, make_transform
from fusion_core.model.trajectory import Trajectory
from fusion_core.recordings.tum_trajectory import read_tum_trajectory
from fusion_core.workflows.map.options import shown_map
from fusion_core.workflows.map.result_folder import MapResults, read_grid

VISUAL_MAP = "visual_map.npz"
_CAMERA_TRAJECTORY, _TRAJECTORY, _CLOUD = "trajectory_camera.tum", "trajectory.tum", "cloud.ply"
_NO_LANDMARK = -1
T_BODY_CAMERA = make_transform(R_BODY_OPTICAL, np.zeros(3))
"""(4, 4) of optical axes (right, down, ahead) in body axes (ahead, left, up)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VisualResults:
    """A run's keyframes, in the map.

    ``trajectory``: of the camera's optical frame, a pose an image. ``stamps_ns``: (K,) of the
    keyframes, ``T_map_camera``: (K, 4, 4). Keyframe ``k`` has the features ``offsets[k]`` to
    ``offsets[k + 1]`` ((K + 1,)) of ``pixels``: (F, 2) u, v without distortion, and ``landmarks``:
    (F,) the landmark that each sees, -1 for none. ``landmarks_in_map_m``: (M, 3). ``loops``:
    (L, 2) keyframes; ``loop_inliers``: (L,).
    """

    trajectory: Trajectory
    stamps_ns: IntArray
    T_map_camera: FloatArray
    offsets: IntArray
    pixels: Float32Array
    landmarks: IntArray
    landmarks_in_map_m: FloatArray
    loops: IntArray
    loop_inliers: IntArray

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                read_only(value)
        count = self.stamps_ns.size
        if self.T_map_camera.shape != (count, 4, 4) or self.offsets.shape != (count + 1,):
            raise ValueError(f"{count} keyframes with {self.T_map_camera.shape[0]} poses")
        if not (np.diff(self.offsets) >= 0).all() or (count and self.offsets[0] != 0):
            raise ValueError("the offsets of the keyframes' features must ascend from 0")
        if self.pixels.shape != (int(self.offsets[-1]), 2) or len(self.landmarks) != len(
            self.pixels
        ):
            raise ValueError(f"{self.offsets[-1]} features with {self.pixels.shape[0]} pixels")
        if self.loops.shape != (len(self.loop_inliers), 2):
            raise ValueError(f"{self.loops.shape} loops with {len(self.loop_inliers)} counts")
        if ((self.loops < 0) | (self.loops >= count)).any():
            raise ValueError("a loop joins keyframes that are not there")

    def matches(self, first: int, second: int) -> tuple[Float32Array, Float32Array]:
        """(M, 2) pixels in each of two keyframes of the landmarks that both see, by landmark."""
        seen = [self._seen_by(first), self._seen_by(second)]
        _, in_first, in_second = np.intersect1d(seen[0][0], seen[1][0], return_indices=True)
        return self.pixels[seen[0][1][in_first]], self.pixels[seen[1][1][in_second]]

    def shared_counts(self, keyframe: int) -> IntArray:
        """(K,) how many landmarks each keyframe shares with one; 0 with itself."""
        own, _ = self._seen_by(keyframe)
        shared = np.isin(self.landmarks, own)
        ends = np.concatenate([[0], np.cumsum(shared)])
        counts: IntArray = ends[self.offsets[1:]] - ends[self.offsets[:-1]]
        counts[keyframe] = 0
        return counts

    def _seen_by(self, keyframe: int) -> tuple[IntArray, IntArray]:
        """The landmarks that a keyframe sees, ascending, and the feature of each."""
        begin, end = self.offsets[keyframe : keyframe + 2]
        landmarks, features = np.unique(self.landmarks[begin:end], return_index=True)
        known = landmarks != _NO_LANDMARK
        return landmarks[known], begin + features[known]


def has_visual_results(folder: Path) -> bool:
    """Whether a folder of results is of visual SLAM."""
    return (folder / VISUAL_MAP).is_file()


def read_visual_results(folder: Path) -> VisualResults:
    """Read what ``map --slam visual`` wrote. Raises ExportError where a file is not as it writes
    it."""
    try:
        require_intact(folder, (VISUAL_MAP, _TRAJECTORY), "map")
        path = folder / _CAMERA_TRAJECTORY
        trajectory = read_tum_trajectory(path if path.exists() else folder / _TRAJECTORY).trajectory
        held = read_arrays(folder / VISUAL_MAP)
        return VisualResults(
            trajectory=trajectory,
            stamps_ns=held["stamps_ns"].astype(np.int64),
            T_map_camera=held["T_map_camera"].astype(np.float64),
            offsets=held["offsets"].astype(np.int64),
            pixels=held["pixels"].astype(np.float32),
            landmarks=held["landmarks"].astype(np.int64),
            landmarks_in_map_m=held["landmarks_in_map_m"].astype(np.float64),
            loops=held["loops"].astype(np.int64).reshape(-1, 2),
            loop_inliers=held["loop_inliers"].astype(np.int64),
        )
    except (OSError, KeyError, IndexError, ScanLoomError, *UNREADABLE_ARRAYS) as error:
        raise _unreadable(folder, error) from error


def read_visual_map(folder: Path, visual: VisualResults) -> MapResults:
    """The same run as ``read_map_results`` has others: the trajectory in body axes (x where the
    camera looks), untrusted where it was lost or doubtful, and the map that is the result.

    Raises ExportError.
    """
    try:
        require_intact(folder, ("report.json",), "map")
        report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
        # Visual SLAM maps what the camera sees, unless both sensors' maps were fused.
        shown = shown_map({"scan": "camera"} | report)
        grid = folder / f"map_{shown}.yaml"
        require_intact(folder, (grid.name, f"{grid.stem}.pgm"))
        trajectory = visual.trajectory
        T_map_body = trajectory.T_map_body @ invert_transform(T_BODY_CAMERA)
        trusted = np.ones(trajectory.stamps_ns.size, dtype=np.bool_)
        for stretch in [*report.get("lost", []), *report.get("doubtful", [])]:
            from_ns, to_ns = (round(stretch[name] * NS_PER_S) for name in ("from_s", "to_s"))
            # Stamps in seconds are rounded.
            late = trajectory.stamps_ns >= from_ns - NS_PER_MS
            trusted[late & (trajectory.stamps_ns <= to_ns + NS_PER_MS)] = False
        ends_m = visual.T_map_camera[visual.loops, :2, 3]
        return MapResults(
            report=report,
            trajectory=Trajectory(stamps_ns=trajectory.stamps_ns, T_map_body=T_map_body),
            trusted=trusted,
            loops_m=ends_m.reshape(-1, 4),
            effective=np.empty((0, 2)),
            weight_stamps_s=np.empty(0),
            translation_weights={},
            rotation_weights={},
            grid=read_grid(grid) if grid.exists() else None,
        )
    except (OSError, ValueError, KeyError, TypeError, ScanLoomError) as error:
        raise _unreadable(folder, error) from error


def _unreadable(folder: Path, error: Exception) -> ExportError:
    return ExportError(
        f"cannot be read back: {type(error).__name__}: {error}.",
        file=folder,
        advice="Run it again.",
    )


def read_run_cloud(folder: Path) -> tuple[Float32Array, ByteArray]:
    """(P, 3) points in the map and their (P, 3) colours; none where no cloud was written.

    Raises ScanLoomError where the file is not as it was written.
    """
    path = folder / _CLOUD
    if not path.exists():
        return np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)
    require_intact(folder, (path.name,), "map")
    # Imported here: it takes most of a second and 200 MiB.
    import open3d as o3d

    cloud: Any = o3d.t.io.read_point_cloud(path)
    points_m = cloud.point.positions.numpy().astype(np.float32)
    if "colors" not in cloud.point:
        return points_m, np.full(points_m.shape, 128, dtype=np.uint8)
    rgb = cloud.point.colors.numpy()
    if rgb.dtype != np.uint8:
        rgb = np.rint(255.0 * np.clip(rgb, 0.0, 1.0))
    return points_m, rgb.astype(np.uint8)
