"""Ground truth of a recording: true ranges, true depths, and which samples are noise."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fusion_core.evaluation.truth_arrays import UNREADABLE_ARRAYS, read_arrays
from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import (
    R_BODY_OPTICAL,
    ByteArray,
    FloatArray,
    IntArray,
    read_only,
)
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll

Arrays = dict[str, npt.NDArray[Any]]

MM_PER_M = 1000.0
_TRUE_CLASSES = (NoiseClass.GOOD, NoiseClass.HOLE, NoiseClass.BURR)


@dataclass(frozen=True, slots=True, kw_only=True)
class LeverArm:
    """A mount measured by hand, for a truth that has only the camera's yaw.

    ``forward_m`` and ``left_m``: the camera's origin seen from the LiDAR's. A pitch of 0 is a
    level camera, positive looks down.
    """

    forward_m: float
    left_m: float
    lidar_height_m: float
    camera_height_m: float
    pitch_rad: float = 0.0

    def mount(self, yaw_rad: float) -> FloatArray:
        """(4, 4) T_lidar_camera of an optical frame that looks ``yaw_rad`` to the left."""
        rotation = rotation_from_yaw_pitch_roll(yaw_rad, self.pitch_rad, 0.0) @ R_BODY_OPTICAL
        up_m = self.camera_height_m - self.lidar_height_m
        return make_transform(rotation, np.array([self.forward_m, self.left_m, up_m]))


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraTruth:
    """The truth of one depth camera.

    ``stamp_ns``: (K,) as recorded. ``depth_mm``: (K, H, W) along the optical axis, 0 or NaN where
    there is none; kept in the file's unit because it is by far the largest array.
    ``kind``: (K, H, W) class codes. ``intrinsics``: (fx, fy, cx, cy) or None.
    ``T_lidar_camera``: (4, 4) or None. ``topic`` is None where the file names none.
    """

    topic: str | None
    stamp_ns: IntArray
    depth_mm: npt.NDArray[Any]
    kind: ByteArray
    intrinsics: tuple[float, float, float, float] | None
    T_lidar_camera: FloatArray | None

    def __post_init__(self) -> None:
        for array in (self.stamp_ns, self.depth_mm, self.kind):
            read_only(array)

    def depth_m(self, frame: IntArray, row: IntArray, column: IntArray) -> FloatArray:
        """True depth at pixels, NaN where the truth has none."""
        depth_mm = self.depth_mm[frame, row, column].astype(np.float64)
        return np.where(depth_mm > 0.0, depth_mm / MM_PER_M, np.nan)


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """The truth of a recording, as in its file.

    ``scan_stamp_ns``: (S,). ``range_m``: (S, N), NaN where there is none; it may exceed what the
    LiDAR can measure. ``kind``: (S, N) class codes. ``pose``: (S, 3) x, y, yaw of the LiDAR in the
    world. Angles, clock and poses are None where unknown.
    """

    file: Path
    scan_stamp_ns: IntArray
    range_m: FloatArray
    kind: ByteArray
    angle_min_rad: float | None
    angle_increment_rad: float | None
    clock_offset_ms: float | None
    cameras: tuple[CameraTruth, ...]
    pose: FloatArray | None = None

    def __post_init__(self) -> None:
        for array in (self.scan_stamp_ns, self.range_m, self.kind):
            read_only(array)
        if self.pose is not None:
            read_only(self.pose)


def load_truth(
    path: Path, *, lever_arm: LeverArm | None = None, clock_offset_ms: float | None = None
) -> Truth:
    """Read and check a truth file.

    ``lever_arm`` and ``clock_offset_ms`` (camera stamp - LiDAR stamp of the same instant) are used
    only where the file has no ``T_lidar_camera`` and no ``clock_offset_ms``.

    Raises ScanLoomError where the file cannot be read, lacks an array, or has one of a wrong shape.
    """
    arrays = _read_arrays(path)
    scan_stamp_ns = _read_stamps(arrays, "scan_stamp", path)
    range_m = _require_array(arrays, "scan_true", path, ndim=2).astype(np.float64)
    _require_shape(range_m.shape[:1], scan_stamp_ns.shape, "scan_true", path)
    range_m[~(np.isfinite(range_m) & (range_m > 0.0))] = np.nan
    own_clock = _read_scalar(arrays, "clock_offset_ms")
    return Truth(
        file=path,
        scan_stamp_ns=scan_stamp_ns,
        range_m=range_m,
        kind=_read_classes(arrays, "scan_kind", range_m.shape, path),
        angle_min_rad=_read_scalar(arrays, "lidar_angle_min"),
        angle_increment_rad=_read_scalar(arrays, "lidar_angle_increment"),
        clock_offset_ms=clock_offset_ms if own_clock is None else own_clock,
        cameras=_read_cameras(arrays, path, lever_arm),
        pose=_read_poses(arrays, scan_stamp_ns.size, path),
    )


def _read_poses(arrays: Arrays, scans: int, path: Path) -> FloatArray | None:
    if "pose" not in arrays:
        return None
    pose = _require_array(arrays, "pose", path, ndim=2).astype(np.float64)
    _require_shape(pose.shape, (scans, 3), "pose", path)
    return pose


def _read_arrays(path: Path) -> Arrays:
    try:
        return read_arrays(path)
    except (OSError, *UNREADABLE_ARRAYS) as error:
        problem = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise ScanLoomError(
            f"cannot be read as a truth file: {problem}.", file=path, advice=_ADVICE
        ) from error


_ADVICE = "Give the .npz that was written with the recording."


def _read_cameras(
    arrays: Arrays, path: Path, lever_arm: LeverArm | None
) -> tuple[CameraTruth, ...]:
    """One camera under plain names, or several under names that end in _0, _1, ..."""
    suffixes = [""]
    if "depth_true" not in arrays:
        count = sum(name.removeprefix("depth_true_").isdigit() for name in arrays)
        suffixes = [f"_{camera}" for camera in range(max(count, 1))]
    count = len(suffixes)
    topics = _read_per_camera(arrays, "camera_topics", (), count, path)
    intrinsics = _read_per_camera(arrays, "intrinsics", (4,), count, path)
    mounts = _read_per_camera(arrays, "T_lidar_camera", (4, 4), count, path)
    if mounts is None and lever_arm is not None:
        yaws = _read_per_camera(arrays, "cam_yaw", (), count, path)
        if yaws is not None:
            mounts = np.stack([lever_arm.mount(float(yaw_rad)) for yaw_rad in yaws])
    cameras = []
    for camera, suffix in enumerate(suffixes):
        depth_mm = _require_array(arrays, f"depth_true{suffix}", path, ndim=3)
        shared = "depth_stamp" if f"depth_stamp{suffix}" not in arrays else f"depth_stamp{suffix}"
        stamp_ns = _read_stamps(arrays, shared, path)
        _require_shape(depth_mm.shape[:1], stamp_ns.shape, f"depth_true{suffix}", path)
        own_intrinsics = None
        if intrinsics is not None:
            fx, fy, cx, cy = map(float, intrinsics[camera])
            own_intrinsics = fx, fy, cx, cy
        cameras.append(
            CameraTruth(
                topic=None if topics is None else str(topics[camera]),
                stamp_ns=stamp_ns,
                depth_mm=depth_mm,
                kind=_read_classes(arrays, f"depth_kind{suffix}", depth_mm.shape, path),
                intrinsics=own_intrinsics,
                T_lidar_camera=None if mounts is None else mounts[camera].astype(np.float64),
            )
        )
    return tuple(cameras)


def _require_array(arrays: Arrays, name: str, path: Path, *, ndim: int) -> npt.NDArray[Any]:
    if name not in arrays:
        raise ScanLoomError(f"has no array {name!r}.", file=path, advice=_ADVICE)
    array = arrays[name]
    if array.ndim != ndim or array.dtype.kind not in "iuf":
        raise ScanLoomError(
            f"{name} must be a numeric array of {ndim} dimensions, is {array.dtype} {array.shape}.",
            file=path,
            advice=_ADVICE,
        )
    return array


def _read_stamps(arrays: Arrays, name: str, path: Path) -> IntArray:
    stamps = _require_array(arrays, name, path, ndim=1)
    if stamps.dtype.kind not in "iu":
        raise ScanLoomError(
            f"{name} must be integer nanoseconds, is {stamps.dtype}.", file=path, advice=_ADVICE
        )
    return stamps.astype(np.int64)


def _read_classes(arrays: Arrays, name: str, shape: tuple[int, ...], path: Path) -> ByteArray:
    kind = _require_array(arrays, name, path, ndim=len(shape))
    _require_shape(kind.shape, shape, name, path)
    if kind.size and not (kind.min() >= min(_TRUE_CLASSES) and kind.max() <= max(_TRUE_CLASSES)):
        raise ScanLoomError(
            f"{name} holds codes from {kind.min()} to {kind.max()}, not only 0 good, 1 hole, "
            "2 burr.",
            file=path,
            advice=_ADVICE,
        )
    return kind.astype(np.uint8, copy=False)


def _require_shape(shape: tuple[int, ...], wanted: tuple[int, ...], name: str, path: Path) -> None:
    if shape != wanted:
        raise ScanLoomError(
            f"{name} has shape {shape}, expected {wanted}.", file=path, advice=_ADVICE
        )


def _read_scalar(arrays: Arrays, name: str) -> float | None:
    return float(arrays[name].reshape(-1)[0]) if name in arrays else None


def _read_per_camera(
    arrays: Arrays, name: str, shape: tuple[int, ...], count: int, path: Path
) -> npt.NDArray[Any] | None:
    """(count, *shape); with one camera the first axis may be left out."""
    if name not in arrays:
        return None
    array = arrays[name]
    if count == 1 and array.shape == shape:
        array = array[np.newaxis]
    _require_shape(array.shape, (count, *shape), name, path)
    return array
