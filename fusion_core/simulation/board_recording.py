"""A recording of a 2D LiDAR and a camera before a board that is carried about, with its truth.

The board stands still at each place for a while, swaying by a millimetre, and is carried on.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fusion_core.model.conventions import NS_PER_MS, NS_PER_S, FloatArray
from fusion_core.model.geometry import make_transform
from fusion_core.model.progress import Progress, silent
from fusion_core.model.seeds import SEED_MAX
from fusion_core.model.sensors import CameraInfo, ColorImage, LaserScan
from fusion_core.recordings.ros2_writer import Ros2McapWriter
from fusion_core.settings import StageSettings, setting
from fusion_core.simulation.board_room import (
    INTRINSICS,
    RIM_M,
    SQUARE_M,
    SQUARES,
    BoardImages,
    Carrier,
    draw_board_pose,
    draw_camera,
    true_ranges_m,
)
from fusion_core.simulation.lidar import LidarNoise, LidarView, add_noise
from fusion_core.simulation.random_streams import RandomStream, make_generator
from fusion_core.simulation.truth import TruthWriter, simulated_errors, truth_path

BOARD_SCENE = "board"
DESCRIPTION = "A checkerboard (7x5 inner corners, 0.1 m) is carried before a LiDAR and a camera"
START_NS = 1_700_000_000 * NS_PER_S
_BEAMS, _INCREMENT_RAD = 682, 2.0 * np.pi / 1024.0
_RANGE_LIMITS_M = (0.06, 5.6)
# The camera is not triggered by the LiDAR.
_CAMERA_DELAY_NS = 17 * NS_PER_MS
_CORNER_FAR_M = 10.0


class BoardSceneSettings(StageSettings):
    """What a user may change about the scene."""

    seed: int = setting(1, "Decides the mounting, the places and the noise", ge=0, le=SEED_MAX)
    places: int = setting(30, "Places to which the board is carried", ge=1, le=500)
    still_s: float = setting(1.0, "How long it stands at each", unit="s", ge=0.0, le=60.0)
    carried_s: float = setting(
        0.6, "How long it is carried to the next", unit="s", ge=0.01, le=60.0
    )
    camera_rate_hz: float = setting(5.0, "Images a second", unit="Hz", ge=0.1, le=120.0)
    lidar_rate_hz: float = setting(10.0, "Sweeps a second", unit="Hz", ge=0.1, le=120.0)
    sway_m: float = setting(
        0.001, "Standard deviation of the standing board's place", unit="m", ge=0.0, le=0.1
    )


def write_board_recording(
    path: Path, settings: BoardSceneSettings | None = None, progress: Progress = silent
) -> None:
    """Write a ROS 2 MCAP file, and ``NAME.truth.npz`` beside it with ``T_camera_lidar``.

    The same settings give the same bytes. Raises ExportError where a file cannot be written.
    """
    settings = settings or BoardSceneSettings()
    run = _BoardRun(settings)
    total_ms = round(run.duration_s * 1000.0)
    with TruthWriter(truth_path(path)) as truth, Ros2McapWriter(path) as writer:
        truth.put(run.constant_truth())
        for after_ns, is_image in run.events():
            progress(after_ns // NS_PER_MS, total_ms, "recording")
            if is_image:
                T_lidar_board = run.write_image(writer, after_ns)
                truth.append("image_stamp", np.array(START_NS + after_ns, dtype=np.int64))
                truth.append("T_lidar_board", T_lidar_board)
            else:
                run.write_scan(writer, after_ns)
    progress(total_ms, total_ms, "recording")


class _BoardRun:
    def __init__(self, settings: BoardSceneSettings) -> None:
        self._settings = settings
        self.T_camera_lidar = draw_camera(settings.seed)
        rng = make_generator(settings.seed, RandomStream.PATH)
        self._places = [draw_board_pose(self.T_camera_lidar, rng) for _ in range(settings.places)]
        self._carriers = [
            Carrier(float(rng.uniform(0.3, 0.6)), float(rng.uniform(-0.4, 0.4)))
            for _ in range(settings.places)
        ]
        self._images = BoardImages(self.T_camera_lidar, settings.seed)
        self._noise = LidarNoise()
        self._step_s = settings.still_s + settings.carried_s
        self.duration_s = settings.places * self._step_s

    def constant_truth(self) -> dict[str, np.ndarray[tuple[int, ...], np.dtype[np.generic]]]:
        return {
            "T_camera_lidar": self.T_camera_lidar,
            "intrinsics": np.array(
                [INTRINSICS.fx, INTRINSICS.fy, INTRINSICS.cx, INTRINSICS.cy], dtype=np.float64
            ),
            "board_squares": np.array(SQUARES, dtype=np.int64),
            "board_square_m": np.array(SQUARE_M),
            "board_rim_m": np.array(RIM_M),
            "seed": np.array(self._settings.seed, dtype=np.int64),
            "simulated_errors": simulated_errors(lidar=self._noise, board=self._settings),
        }

    def events(self) -> Iterator[tuple[int, bool]]:
        """Nanoseconds after the start, and whether an image is taken (else a sweep begins)."""
        settings = self._settings
        sweeps = [
            (int(index * NS_PER_S / settings.lidar_rate_hz), False)
            for index in range(int(self.duration_s * settings.lidar_rate_hz))
        ]
        images = [
            (_CAMERA_DELAY_NS + int(index * NS_PER_S / settings.camera_rate_hz), True)
            for index in range(int(self.duration_s * settings.camera_rate_hz))
        ]
        yield from sorted(sweeps + images)

    def write_image(self, writer: Ros2McapWriter, after_ns: int) -> FloatArray:
        T_lidar_board, _ = self._board_at(after_ns)
        rng = make_generator(self._settings.seed, RandomStream.CAMERA, after_ns)
        stamp_ns = START_NS + after_ns
        frame_id = "camera_color_optical_frame"
        rgb = self._images.image(T_lidar_board, rng)
        image = ColorImage(stamp_ns=stamp_ns, received_ns=stamp_ns, frame_id=frame_id, rgb=rgb)
        info = CameraInfo(
            stamp_ns=stamp_ns, received_ns=stamp_ns, frame_id=frame_id, intrinsics=INTRINSICS
        )
        writer.write_color("/camera/color/image_raw", image)
        writer.write_camera_info("/camera/color/camera_info", info)
        return T_lidar_board

    def write_scan(self, writer: Ros2McapWriter, after_ns: int) -> None:
        T_lidar_board, carrier = self._board_at(after_ns)
        first_rad = -0.5 * (_BEAMS - 1) * _INCREMENT_RAD
        azimuths_rad = first_rad + _INCREMENT_RAD * np.arange(_BEAMS, dtype=np.float64)
        true_m, cosines = true_ranges_m(azimuths_rad, T_lidar_board, carrier)
        nothing = np.zeros(_BEAMS, dtype=np.bool_)
        noisy = add_noise(
            LidarView(
                true_m=true_m,
                incidence_cos=np.clip(cosines, 0.0, 1.0),
                glass=nothing,
                mirror=nothing,
                dark=nothing,
                sunlit=nothing,
                behind_m=np.full(_BEAMS, np.nan),
                corner_m=np.full(_BEAMS, _CORNER_FAR_M),
            ),
            self._noise,
            _RANGE_LIMITS_M,
            make_generator(self._settings.seed, RandomStream.LIDAR, after_ns),
        )
        stamp_ns = START_NS + after_ns
        scan = LaserScan(
            stamp_ns=stamp_ns,
            received_ns=stamp_ns,
            frame_id="laser",
            angle_min_rad=first_rad,
            angle_increment_rad=_INCREMENT_RAD,
            range_min_m=_RANGE_LIMITS_M[0],
            range_max_m=_RANGE_LIMITS_M[1],
            ranges_m=noisy.ranges_m,
            scan_time_s=1.0 / self._settings.lidar_rate_hz,
        )
        writer.write_laser_scan("/scan", scan)

    def _board_at(self, after_ns: int) -> tuple[FloatArray, Carrier]:
        """(4, 4) T_lidar_board, and where the person stands behind it."""
        time_s = after_ns / NS_PER_S
        place = min(int(time_s / self._step_s), len(self._places) - 1)
        since_s = time_s - place * self._step_s - self._settings.still_s
        rng = make_generator(self._settings.seed, RandomStream.PATH, 1 + after_ns)
        sway_m = self._settings.sway_m * rng.standard_normal(3)
        here = self._places[place]
        if since_s <= 0.0 or place + 1 == len(self._places):
            return make_transform(here[:3, :3], here[:3, 3] + sway_m), self._carriers[place]
        # A straight way with one turn, slow at its ends.
        fraction = 0.5 - 0.5 * np.cos(np.pi * since_s / self._settings.carried_s)
        there = self._places[place + 1]
        turn = Rotation.from_matrix(here[:3, :3].T @ there[:3, :3]).as_rotvec()
        rotation = here[:3, :3] @ Rotation.from_rotvec(fraction * turn).as_matrix()
        middle = (1.0 - fraction) * here[:3, 3] + fraction * there[:3, 3] + sway_m
        return make_transform(rotation, middle), self._carriers[place]
