"""Song 2022's rig: a spinning LiDAR on an axis that turns, and a camera beside it, in a room.

Frames (Song, Fig. 1):

- ``lidar``: the LiDAR's own, as its driver reports points; z is its spin axis.
- ``axis``: fixed to the turning part; z is the axis. Nominally the LiDAR lies on its side there,
  its spin axis along y and its azimuth 0 along x (``T_AXIS_LIDAR_NOMINAL``). In truth it is also
  rotated by θ about x and by β about y, and moved by Δx, Δy (1):
  p_axis = Rx(θ) Ry(β) R_nominal p_lidar + (Δx, Δy, 0).
- ``rig``: O-XYZ, the calibrated LiDAR system. It does not turn, and is ``axis`` at angle 0: for a
  point measured at the axis angle ψ, p_rig = Rz(ψ) p_axis.

``T_camera_lidar`` of the truth maps ``rig`` to the optical frame: the LiDAR of the extrinsics is
the calibrated system. The camera does not turn; it takes one image before the scan, when the axis
is at 0 (§3.1: both are mounted on either side of the axis, and the camera records first).
"""

from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np
from pydantic import model_validator
from scipy.spatial.transform import Rotation

from fusion_core.model.conventions import (
    NS_PER_S,
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
    read_only,
)
from fusion_core.model.geometry import invert_transform, make_transform, transform_points
from fusion_core.model.progress import Progress, silent
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.settings import StageSettings, setting
from fusion_core.simulation.random_streams import RandomStream, make_generator
from fusion_core.simulation.spinning_lidar import (
    RINGS,
    BeamPattern,
    SpinningLidarSettings,
    beam_pattern,
    intensity,
    noisy_range,
)
from fusion_core.simulation.textured_room import (
    SONG_ROOM_M,
    RoomCaster,
    TexturedRoom,
    make_textured_room,
)

START_NS = 1_700_000_000 * NS_PER_S
# The image comes first, and the axis stands still meanwhile.
_IMAGE_BEFORE_SCAN_NS = NS_PER_S
# All of them are held in memory.
_POINTS_MAX = 40_000_000

T_AXIS_LIDAR_NOMINAL: FloatArray = make_transform(
    np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]), np.zeros(3)
)
# Song 2022, Table 1.
_SONG_CAMERA = CameraIntrinsics(
    width=1280, height=960, fx=1055.5179, fy=1052.952, cx=649.637, cy=485.239
)
# Song 2022, Table 4 rounded: x to the right, the optical axis along Y; and its translation.
_R_CAMERA_RIG: FloatArray = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_CAMERA_OFFSET_M = np.array([-0.008, 0.096, -0.009])
# Song 2022, Table 2, in degrees and metres: what a mounting error is about.
_SONG_TILTS_DEG = np.array([1.41, -0.15])
_SONG_OFFSETS_M = np.array([0.001, 0.002])


class TurningRigSettings(StageSettings):
    """What may be changed about the rig and its scan."""

    turn_deg: float = setting(
        360.0, "Angle through which the axis turns", unit="deg", ge=0.0, le=3600.0
    )
    turn_s: float = setting(31.0, "Time that it takes", unit="s", ge=0.1, le=300.0)
    steps: bool = setting(False, "The axis stands still during each scan")
    joint_hz: float = setting(100.0, "Axis angles a second", unit="Hz", ge=1.0, le=1000.0)
    encoder_sigma_deg: float = setting(
        0.005, "Standard deviation of an axis angle", unit="deg", ge=0.0, le=10.0
    )
    tilt_spread_deg: float = setting(
        1.0, "θ and β are those of Song's Table 2 ± this", unit="deg", ge=0.0, le=20.0
    )
    offset_spread_m: float = setting(
        0.01, "Δx and Δy are those of Song's Table 2 ± this", unit="m", ge=0.0, le=1.0
    )
    camera_spread_deg: float = setting(
        2.5, "The camera is rotated by ± this about each axis", unit="deg", ge=0.0, le=45.0
    )
    camera_spread_m: float = setting(
        0.02, "The camera is moved by ± this along each axis", unit="m", ge=0.0, le=1.0
    )
    distortion_k1: float = setting(0.0, "Radial distortion of the lens", ge=-0.5, le=0.5)
    distortion_k2: float = setting(0.0, "Radial distortion of the lens", ge=-0.5, le=0.5)
    image_scale: float = setting(
        1.0, "Pixels a side, relative to the camera's own", ge=0.05, le=2.0
    )
    image_sigma: float = setting(2.0, "Noise of the image's values", ge=0.0, le=100.0)
    room_length_m: float = setting(SONG_ROOM_M[0], "Room's length", unit="m", ge=5.0, le=20.0)
    room_width_m: float = setting(SONG_ROOM_M[1], "Room's width", unit="m", ge=5.0, le=20.0)
    room_height_m: float = setting(SONG_ROOM_M[2], "Room's height", unit="m", ge=2.4, le=6.0)
    lidar: SpinningLidarSettings = SpinningLidarSettings()

    @model_validator(mode="after")
    def _bounded_points(self) -> Self:
        points = self.turn_s * self.lidar.rotation_hz * self.lidar.columns * RINGS
        if points > _POINTS_MAX:
            raise ValueError(
                f"turn_s, rotation_hz and columns make {points:.0f} points, more than {_POINTS_MAX}"
            )
        return self


@dataclass(frozen=True, slots=True, kw_only=True)
class TurningScan:
    """One rotation of the LiDAR.

    ``points_m``: (N, 3) in ``lidar``. ``intensity``: (N,), 0 to 255. ``rings``: (N,), 0 is the
    lowest. ``offsets_s``: (N,) instants since the stamp. ``axis_angles_rad``: (N,) true angles of
    the axis at those instants.
    """

    stamp_ns: int
    points_m: Float32Array
    intensity: Float32Array
    rings: ByteArray
    offsets_s: Float32Array
    axis_angles_rad: FloatArray

    def __post_init__(self) -> None:
        for array in (
            self.points_m,
            self.intensity,
            self.rings,
            self.offsets_s,
            self.axis_angles_rad,
        ):
            read_only(array)


@dataclass(frozen=True, slots=True, kw_only=True)
class TurningRigData:
    """A simulated turn with its truth; the frames are those of the module.

    ``joint_stamps_ns``, ``joint_angles_rad``: (J,) the axis as its encoder reports it.
    ``theta_rad``, ``beta_rad``, ``delta_m`` (2,): Song's θ, β, (Δx, Δy). ``T_axis_lidar``: with
    them. ``T_camera_lidar``: of the ``rig``. ``T_room_rig``: the room's frame has a corner of the
    floor at its origin. ``room_size_m``: length, width, height.
    """

    scans: tuple[TurningScan, ...]
    joint_stamps_ns: IntArray
    joint_angles_rad: FloatArray
    image_stamp_ns: int
    rgb: ByteArray
    intrinsics: CameraIntrinsics
    theta_rad: float
    beta_rad: float
    delta_m: FloatArray
    T_axis_lidar: FloatArray
    T_camera_lidar: FloatArray
    T_room_rig: FloatArray
    room_size_m: tuple[float, float, float]

    def __post_init__(self) -> None:
        for array in (
            self.joint_stamps_ns,
            self.joint_angles_rad,
            self.rgb,
            self.delta_m,
            self.T_axis_lidar,
            self.T_camera_lidar,
            self.T_room_rig,
        ):
            read_only(array)

    def cloud_in_rig(self, T_axis_lidar: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """(N, 3) points in ``rig`` and their (N,) intensities, noise included.

        By the true mounting where ``T_axis_lidar`` is None; by T_AXIS_LIDAR_NOMINAL they are as
        before the self-calibration.
        """
        T = self.T_axis_lidar if T_axis_lidar is None else T_axis_lidar
        parts = [
            turn_points(transform_points(T, scan.points_m.astype(np.float64)), scan.axis_angles_rad)
            for scan in self.scans
        ]
        return np.concatenate(parts), np.concatenate([scan.intensity for scan in self.scans])


def turn_points(points_in_axis_m: FloatArray, angles_rad: FloatArray) -> FloatArray:
    """(N, 3) points in ``rig``: each rotated about z by its axis angle (N,)."""
    c, s = np.cos(angles_rad), np.sin(angles_rad)
    x, y, z = points_in_axis_m.T
    return np.stack([c * x - s * y, s * x + c * y, z], axis=1)


def axis_from_lidar(theta_rad: float, beta_rad: float, delta_m: FloatArray) -> FloatArray:
    """(4, 4) T_axis_lidar of Song's (1), after the nominal mounting."""
    tilt = Rotation.from_euler("XY", [theta_rad, beta_rad]).as_matrix()
    return make_transform(tilt, np.array([*delta_m, 0.0])) @ T_AXIS_LIDAR_NOMINAL


def simulate_turning_rig(
    settings: TurningRigSettings, seed: int, progress: Progress = silent
) -> TurningRigData:
    """A turn of the rig in a room; room, mounting and noise come from the seed."""
    rng = make_generator(seed, RandomStream.TURNING_RIG)
    size_m = (settings.room_length_m, settings.room_width_m, settings.room_height_m)
    room = make_textured_room(seed, size_m)
    caster = RoomCaster(room, settings.lidar.beam_footprint_m)
    tilts = _SONG_TILTS_DEG + settings.tilt_spread_deg * rng.uniform(-1.0, 1.0, 2)
    theta_rad, beta_rad = (float(angle) for angle in np.deg2rad(tilts))
    delta_m = _SONG_OFFSETS_M + settings.offset_spread_m * rng.uniform(-1.0, 1.0, 2)
    T_axis_lidar = axis_from_lidar(theta_rad, beta_rad, delta_m)
    T_room_rig = _place_rig(room, rng)
    T_camera_lidar = _camera_pose(settings, rng)
    intrinsics = _intrinsics(settings)
    rgb = _take_image(
        caster,
        room,
        T_room_rig @ invert_transform(T_camera_lidar),
        intrinsics,
        settings.image_sigma,
        make_generator(seed, RandomStream.CAMERA),
    )
    joint_stamps_ns, joint_angles_rad = _joint_samples(settings, rng)
    return TurningRigData(
        scans=_scan_turn(settings, seed, caster, T_room_rig, T_axis_lidar, progress),
        joint_stamps_ns=joint_stamps_ns,
        joint_angles_rad=joint_angles_rad,
        image_stamp_ns=START_NS - _IMAGE_BEFORE_SCAN_NS,
        rgb=rgb,
        intrinsics=intrinsics,
        theta_rad=theta_rad,
        beta_rad=beta_rad,
        delta_m=delta_m,
        T_axis_lidar=T_axis_lidar,
        T_camera_lidar=T_camera_lidar,
        T_room_rig=T_room_rig,
        room_size_m=size_m,
    )


def _scan_turn(
    settings: TurningRigSettings,
    seed: int,
    caster: RoomCaster,
    T_room_rig: FloatArray,
    T_axis_lidar: FloatArray,
    progress: Progress,
) -> tuple[TurningScan, ...]:
    pattern = beam_pattern(settings.lidar)
    count = max(1, round(settings.turn_s * settings.lidar.rotation_hz))
    scans = []
    for index in range(count):
        rng = make_generator(seed, RandomStream.LIDAR, index)
        start_s = index / settings.lidar.rotation_hz
        instants_s = np.full(len(pattern.rings), start_s)
        if not settings.steps:
            instants_s = instants_s + pattern.offsets_s
        angles_rad = _axis_angle(settings, instants_s)
        scan = _scan(settings, pattern, angles_rad, caster, T_room_rig, T_axis_lidar, rng)
        scans.append(
            TurningScan(
                stamp_ns=START_NS + round(start_s * NS_PER_S),
                points_m=scan[0],
                intensity=scan[1],
                rings=pattern.rings,
                offsets_s=pattern.offsets_s.astype(np.float32),
                axis_angles_rad=angles_rad,
            )
        )
        progress(index + 1, count, "scanning")
    return tuple(scans)


def _scan(
    settings: TurningRigSettings,
    pattern: BeamPattern,
    angles_rad: FloatArray,
    caster: RoomCaster,
    T_room_rig: FloatArray,
    T_axis_lidar: FloatArray,
    rng: np.random.Generator,
) -> tuple[Float32Array, Float32Array]:
    """Points (N, 3) in ``lidar`` and intensities (N,)."""
    count = len(angles_rad)
    origins_in_axis = np.broadcast_to(T_axis_lidar[:3, 3], (count, 3))
    origins_m = transform_points(T_room_rig, turn_points(origins_in_axis, angles_rad))
    directions_in_rig = turn_points(pattern.directions @ T_axis_lidar[:3, :3].T, angles_rad)
    directions = directions_in_rig @ T_room_rig[:3, :3].T
    hits = caster.cast(origins_m, directions)
    range_m = hits.distance
    reflectance = caster.infrared(hits, origins_m + range_m[:, np.newaxis] * directions)
    measured_m = noisy_range(range_m, settings.lidar, rng)
    values = intensity(reflectance, range_m, hits.incidence_cos, settings.lidar, rng)
    points_m = measured_m[:, np.newaxis] * pattern.directions
    return points_m.astype(np.float32), values.astype(np.float32)


def _axis_angle(settings: TurningRigSettings, instants_s: FloatArray) -> FloatArray:
    """(N,) true angles at instants since the start of the scan."""
    return float(np.deg2rad(settings.turn_deg)) / settings.turn_s * instants_s


def _joint_samples(
    settings: TurningRigSettings, rng: np.random.Generator
) -> tuple[IntArray, FloatArray]:
    """What the encoder reports, from a little before the first point to a little after the last."""
    count = round(settings.turn_s * settings.joint_hz) + 3
    instants_s = (np.arange(count) - 1) / settings.joint_hz
    held_s = instants_s
    if settings.steps:
        # Up to the end of a scan the axis stands where it stood at its start.
        hz = settings.lidar.rotation_hz
        held_s = np.floor(instants_s * hz + 1e-9) / hz
    noise = np.deg2rad(settings.encoder_sigma_deg) * rng.standard_normal(count)
    stamps_ns = START_NS + np.rint(instants_s * NS_PER_S).astype(np.int64)
    return stamps_ns, _axis_angle(settings, held_s) + noise


def _place_rig(room: TexturedRoom, rng: np.random.Generator) -> FloatArray:
    """T_room_rig: at the viewpoint, Y where the camera is to look, not quite level."""
    yaw = Rotation.from_euler("z", room.heading_rad - 0.5 * np.pi)
    tilt = Rotation.from_rotvec(np.deg2rad([*rng.uniform(-1.5, 1.5, 2), 0.0]))
    return make_transform((yaw * tilt).as_matrix(), room.viewpoint_m)


def _camera_pose(settings: TurningRigSettings, rng: np.random.Generator) -> FloatArray:
    """T_camera_lidar, near that of Song's Table 4."""
    turn = np.deg2rad(settings.camera_spread_deg) * rng.uniform(-1.0, 1.0, 3)
    offset_m = _CAMERA_OFFSET_M + settings.camera_spread_m * rng.uniform(-1.0, 1.0, 3)
    return make_transform(Rotation.from_rotvec(turn).as_matrix() @ _R_CAMERA_RIG, offset_m)


def _intrinsics(settings: TurningRigSettings) -> CameraIntrinsics:
    coefficients = (settings.distortion_k1, settings.distortion_k2, 0.0, 0.0, 0.0)
    distortion = coefficients if any(coefficients) else ()
    scale = settings.image_scale
    return replace(
        _SONG_CAMERA,
        width=round(scale * _SONG_CAMERA.width),
        height=round(scale * _SONG_CAMERA.height),
        fx=scale * _SONG_CAMERA.fx,
        fy=scale * _SONG_CAMERA.fy,
        # The corner of the image stays; centres of pixels are integers.
        cx=scale * (_SONG_CAMERA.cx + 0.5) - 0.5,
        cy=scale * (_SONG_CAMERA.cy + 0.5) - 0.5,
        distortion=distortion,
    )


def _take_image(
    caster: RoomCaster,
    room: TexturedRoom,
    T_room_camera: FloatArray,
    intrinsics: CameraIntrinsics,
    sigma: float,
    rng: np.random.Generator,
) -> ByteArray:
    """(H, W, 3): four rays a pixel, lit by a lamp under the ceiling and by what it scatters."""
    length, width, height = room.size_m
    lamp_m = np.array([0.5 * length, 0.5 * width, height - 0.15])
    K = intrinsics.matrix
    distortion = np.array(intrinsics.distortion or (0.0,) * 5)
    image = np.zeros((intrinsics.height, intrinsics.width, 3))
    column, row = np.meshgrid(
        np.arange(intrinsics.width, dtype=np.float64),
        np.arange(intrinsics.height, dtype=np.float64),
    )
    for shift_u, shift_v in ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)):
        pixels = np.stack([column + shift_u, row + shift_v], axis=-1).reshape(-1, 1, 2)
        plane = cv2.undistortPoints(pixels, K, distortion).reshape(-1, 2)
        directions = np.column_stack([plane, np.ones(len(plane))]) @ T_room_camera[:3, :3].T
        hits = caster.cast(T_room_camera[:3, 3], directions)
        points_m = T_room_camera[:3, 3] + hits.distance[:, np.newaxis] * directions
        to_lamp = lamp_m - points_m
        to_lamp /= np.linalg.norm(to_lamp, axis=1, keepdims=True)
        lit = 0.55 + 0.5 * np.abs(np.einsum("ij,ij->i", hits.normals, to_lamp))
        image += (caster.rgb(hits, points_m) * lit[:, np.newaxis]).reshape(image.shape)
    noisy = 0.25 * image + sigma * rng.standard_normal(image.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
