"""What the sensors deliver: metres, radians, nanoseconds, NaN for missing."""

from dataclasses import dataclass, replace
from math import copysign, isfinite, pi, remainder, tau

import numpy as np

from fusion_core.model.conventions import (
    ByteArray,
    Float32Array,
    FloatArray,
    RingArray,
    read_only,
)
from fusion_core.model.sweep import is_full_circle, require_plausible_sweep

# From a fisheye image of a few pixels to pixels of 1 µm at a focal length of 1 m.
_FOCAL_LENGTH_LIMITS_PX = (1e-2, 1e6)
# A hundred times the width of an image of 10,000 pixels.
_MAX_CENTRE_PX = 1e6
# k3 multiplies the sixth power of the distance from the axis, which is 1e-9 at the rim of a field
# of view of 4 degrees.
_MAX_DISTORTION = 1e9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaserScan:
    """One sweep of a 2D LiDAR, in its own frame (x forward, angles counter-clockwise).

    ``ranges_m``: (N,) float64, N >= 1, NaN where a beam has no valid range (0, inf, out of limits).
    ``intensities``: (N,) float64 or None. ``angle_increment_rad`` may be negative. Beams and angles
    are those that ``sweep.require_plausible_sweep`` accepts.
    """

    stamp_ns: int
    received_ns: int | None
    frame_id: str
    angle_min_rad: float
    angle_increment_rad: float
    range_min_m: float
    range_max_m: float
    ranges_m: FloatArray
    intensities: FloatArray | None = None
    scan_time_s: float = 0.0
    time_increment_s: float = 0.0

    def __post_init__(self) -> None:
        if self.ranges_m.ndim != 1 or self.ranges_m.dtype != np.float64:
            raise ValueError(f"ranges_m must be (N,) float64, got {self.ranges_m.shape}")
        require_plausible_sweep(self.ranges_m.size, self.angle_min_rad, self.angle_increment_rad)
        if self.intensities is not None and self.intensities.shape != self.ranges_m.shape:
            raise ValueError("intensities must have the shape of ranges_m")
        read_only(self.ranges_m)

    @property
    def angles_rad(self) -> FloatArray:
        """(N,) azimuth of each beam in the LiDAR's frame."""
        steps = np.arange(self.ranges_m.size, dtype=np.float64)
        return self.angle_min_rad + self.angle_increment_rad * steps

    @property
    def is_full_circle(self) -> bool:
        """Whether the last beam is next to the first one."""
        return is_full_circle(self.ranges_m.size, self.angle_increment_rad)

    def beam_behind(self, azimuth_rad: float) -> int:
        """The beam of a full circle that looks away from an azimuth; 0 where the scan has ends."""
        if not self.is_full_circle:
            return 0
        behind_rad = azimuth_rad + pi - self.angle_min_rad
        step_rad = self.angle_increment_rad
        return (
            round(copysign(1.0, step_rad) * behind_rad % tau / abs(step_rad)) % self.ranges_m.size
        )

    def with_seam_at(self, beam: int) -> "LaserScan":
        """The same full circle with its numbers counted from ``beam``: beam k is ``beam`` + k. The
        azimuth of the middle one is within half a turn of 0."""
        if beam == 0:
            return self
        half_rad = 0.5 * self.ranges_m.size * self.angle_increment_rad
        middle_rad = self.angle_min_rad + beam * self.angle_increment_rad + half_rad
        return replace(
            self,
            angle_min_rad=remainder(middle_rad, tau) - half_rad,
            ranges_m=np.roll(self.ranges_m, -beam),
            intensities=None if self.intensities is None else np.roll(self.intensities, -beam),
        )

    def with_ranges(self, ranges_m: FloatArray, intensities: FloatArray | None) -> "LaserScan":
        """The same sweep with other values."""
        return replace(self, ranges_m=ranges_m, intensities=intensities)


FISHEYE_MODELS = ("equidistant", "fisheye")
"""The names of OpenCV's fisheye model."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraIntrinsics:
    """Pinhole model of an image of ``width`` x ``height`` pixels; pixel centres are integers.

    ``distortion`` are OpenCV's coefficients in the order of ``distortion_model``
    (``plumb_bob``: k1 k2 p1 p2 k3); empty or all zero means none.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion_model: str = "plumb_bob"
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        values = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not all(map(isfinite, values)) or self.fx <= 0.0 or self.fy <= 0.0:
            listed = " ".join(f"{value:g}" for value in values)
            raise ValueError(f"intrinsics must be finite with positive focal lengths, got {listed}")
        shortest, longest = _FOCAL_LENGTH_LIMITS_PX
        for name, value, least, most in (
            ("focal length fx", self.fx, shortest, longest),
            ("focal length fy", self.fy, shortest, longest),
            ("centre cx", self.cx, -_MAX_CENTRE_PX, _MAX_CENTRE_PX),
            ("centre cy", self.cy, -_MAX_CENTRE_PX, _MAX_CENTRE_PX),
        ):
            if not least <= value <= most:
                raise ValueError(f"the {name} {value:g} lies outside {least:g} to {most:g} pixels")
        for value in self.distortion:
            if abs(value) > _MAX_DISTORTION:
                raise ValueError(
                    f"the distortion coefficient {value:g} is larger than {_MAX_DISTORTION:g}"
                )

    @property
    def matrix(self) -> FloatArray:
        """(3, 3) K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def is_straight(self) -> bool:
        """Whether the images have no distortion. Zeros of any model mean that, as in ROS."""
        return not any(self.distortion)

    @property
    def is_fisheye(self) -> bool:
        """Whether the distortion is that of OpenCV's fisheye model."""
        return self.distortion_model in FISHEYE_MODELS and not self.is_straight

    @property
    def straight(self) -> "CameraIntrinsics":
        """The same camera without distortion."""
        return replace(self, distortion_model="plumb_bob", distortion=())

    @property
    def opencv_distortion(self) -> FloatArray:
        """The coefficients in one of the lengths that OpenCV's functions of the model take."""
        lengths = (4,) if self.is_fisheye else (4, 5, 8, 12, 14)
        padded = np.zeros(next((n for n in lengths if n >= len(self.distortion)), lengths[-1]))
        padded[: len(self.distortion)] = self.distortion[: padded.size]
        return padded

    def scaled_to(self, shape: tuple[int, int]) -> "CameraIntrinsics":
        """The same camera with images of ``shape`` (height, width).

        Raises ValueError as the constructor does.
        """
        height, width = shape
        across, down = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=across * self.fx,
            fy=down * self.fy,
            cx=across * (self.cx + 0.5) - 0.5,
            cy=down * (self.cy + 0.5) - 0.5,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthImage:
    """A depth image: z along the optical axis.

    ``depth_m``: (H, W) float32 metres, NaN where missing.
    ``encoding``: how the file had it, "16UC1" (millimetres) or "32FC1" (metres), so that an
    export can be of the same kind.
    ``quantum_m``: the file's depth resolution where it is coarse enough to matter; a value lies in
    the middle of its step. None means fine.
    """

    stamp_ns: int
    received_ns: int | None
    frame_id: str
    depth_m: Float32Array
    encoding: str = "32FC1"
    quantum_m: float | None = None

    def __post_init__(self) -> None:
        if self.depth_m.ndim != 2 or self.depth_m.dtype != np.float32:
            raise ValueError(f"depth_m must be (H, W) float32, got {self.depth_m.shape}")
        if self.quantum_m is not None and not self.quantum_m > 0.0:
            raise ValueError(f"quantum_m must be positive, got {self.quantum_m}")
        read_only(self.depth_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class ColorImage:
    """A colour image. ``rgb``: (H, W, 3) uint8."""

    stamp_ns: int
    received_ns: int | None
    frame_id: str
    rgb: ByteArray

    def __post_init__(self) -> None:
        if self.rgb.ndim != 3 or self.rgb.shape[2] != 3 or self.rgb.dtype != np.uint8:
            raise ValueError(f"rgb must be (H, W, 3) uint8, got {self.rgb.shape}")
        read_only(self.rgb)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraInfo:
    """A camera's calibration as recorded; ``intrinsics`` is None where it is uncalibrated."""

    stamp_ns: int
    received_ns: int | None
    frame_id: str
    intrinsics: CameraIntrinsics | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Transform:
    """``T_parent_child`` at one instant: (4, 4) float64, maps child coordinates to the parent's."""

    stamp_ns: int
    parent: str
    child: str
    T_parent_child: FloatArray

    def __post_init__(self) -> None:
        if self.T_parent_child.shape != (4, 4):
            raise ValueError(f"T_parent_child must be (4, 4), got {self.T_parent_child.shape}")
        read_only(self.T_parent_child)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSample:
    """A pose as odometry or a PoseStamped message reports it: ``T_parent_child``.

    ``child`` is empty where the message does not say which body it means (PoseStamped).
    """

    stamp_ns: int
    received_ns: int | None
    parent: str
    child: str
    T_parent_child: FloatArray

    def __post_init__(self) -> None:
        if self.T_parent_child.shape != (4, 4):
            raise ValueError(f"T_parent_child must be (4, 4), got {self.T_parent_child.shape}")
        read_only(self.T_parent_child)


@dataclass(frozen=True, slots=True, kw_only=True)
class TransformBatch:
    """One message of /tf or /tf_static."""

    received_ns: int | None
    transforms: tuple[Transform, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class PointCloud:
    """Points of a 3D LiDAR or a depth camera, in the order in which they were sent.

    ``xyz_m``: (N, 3) float32; a point without a position is NaN in all three, and keeps its place,
    since its index gives ring and azimuth in drivers of spinning scanners.
    ``intensity``: (N,) float32 in the driver's own unit, or None where the cloud has none.
    ``offsets_s``: (N,) float64, when each point was measured, in seconds since ``stamp_ns``, NaN
    where a point has no instant; None where the cloud gives none. ``rings``: (N,) uint16, the laser
    that measured it, or None.
    """

    stamp_ns: int
    received_ns: int | None
    frame_id: str
    xyz_m: Float32Array
    intensity: Float32Array | None = None
    offsets_s: FloatArray | None = None
    rings: RingArray | None = None

    def __post_init__(self) -> None:
        if self.xyz_m.ndim != 2 or self.xyz_m.shape[1] != 3 or self.xyz_m.dtype != np.float32:
            raise ValueError(f"xyz_m must be (N, 3) float32, got {self.xyz_m.shape}")
        if self.intensity is not None:
            if self.intensity.shape != self.xyz_m.shape[:1] or self.intensity.dtype != np.float32:
                raise ValueError(f"intensity must be (N,) float32, got {self.intensity.shape}")
            read_only(self.intensity)
        for name, values, dtype in (
            ("offsets_s", self.offsets_s, np.float64),
            ("rings", self.rings, np.uint16),
        ):
            if values is not None:
                if values.shape != self.xyz_m.shape[:1] or values.dtype != dtype:
                    raise ValueError(f"{name} must be (N,) {np.dtype(dtype)}, got {values.shape}")
                read_only(values)
        read_only(self.xyz_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSample:
    """Positions and velocities of named joints: wheels, or the axis that turns a scanner.

    ``positions``, ``velocities``: (N,) float64 in rad and rad/s (m and m/s for a sliding joint),
    NaN where a driver does not know one; None where the message does not give them.
    """

    stamp_ns: int
    received_ns: int | None
    names: tuple[str, ...]
    positions: FloatArray | None
    velocities: FloatArray | None

    def __post_init__(self) -> None:
        for values in (self.positions, self.velocities):
            if values is not None:
                if values.shape != (len(self.names),) or values.dtype != np.float64:
                    raise ValueError(f"{len(self.names)} joints cannot have {values.shape} values")
                read_only(values)


SensorValue = (
    LaserScan
    | DepthImage
    | ColorImage
    | CameraInfo
    | PoseSample
    | TransformBatch
    | PointCloud
    | JointSample
)
