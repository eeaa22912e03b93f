"""Small recordings written in code, and simulated scenes fused once for the whole session."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from fusion_core.model.conventions import NS_PER_MS, NS_PER_S
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import (
    CameraInfo,
    CameraIntrinsics,
    DepthImage,
    LaserScan,
    PoseSample,
    Transform,
    TransformBatch,
)
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.ros2_writer import Ros2McapWriter
from fusion_core.simulation.scenes import SceneSettings, find_scene, write_scene
from fusion_core.workflows.fuse.fuse import FuseSummary, fuse
from fusion_core.workflows.fuse.session import FuseOptions

START_NS = 1_700_000_000 * NS_PER_S
OPTICAL = rotation_from_yaw_pitch_roll(-np.pi / 2, 0.0, -np.pi / 2)
INTRINSICS = CameraIntrinsics(width=16, height=12, fx=14.0, fy=13.0, cx=7.2, cy=5.6)


class Log:
    """Collects messages in any order and writes them as one MCAP, in the order of their log time.

    Times are in ms after a start; ``late_ms`` is how much later than its stamp a message is logged.
    """

    lens = INTRINSICS
    start_ns = START_NS

    def __init__(self, path: Path) -> None:
        self.path = path
        self._writes: list[tuple[int, Callable[[Ros2McapWriter], None]]] = []
        self._opened: list[Recording] = []

    def _add(self, received_ns: int, write: Callable[[Ros2McapWriter], None]) -> None:
        self._writes.append((received_ns, write))

    def scan(
        self,
        at_ms: float,
        *,
        late_ms: float = 0.0,
        frame: str = "laser",
        mark: float = 2.0,
        beams: int = 9,
    ):
        """A scan of ``beams`` beams at ``mark`` metres."""
        stamp_ns, received_ns = _stamps(at_ms, late_ms)
        scan = LaserScan(
            stamp_ns=stamp_ns,
            received_ns=received_ns,
            frame_id=frame,
            angle_min_rad=-1.0,
            angle_increment_rad=0.25,
            range_min_m=0.1,
            range_max_m=10.0,
            ranges_m=np.full(beams, mark),
        )
        self._add(received_ns, lambda writer: writer.write_laser_scan("/scan", scan))

    def image(
        self,
        at_ms: float,
        *,
        late_ms: float = 0.0,
        name: str = "camera",
        frame: str | None = None,
        shape: tuple[int, int] = (INTRINSICS.height, INTRINSICS.width),
    ):
        """A depth image, by default of 16 x 12 pixels, on ``/NAME/depth/image_raw``."""
        stamp_ns, received_ns = _stamps(at_ms, late_ms)
        image = DepthImage(
            stamp_ns=stamp_ns,
            received_ns=received_ns,
            frame_id=frame or f"{name}_optical",
            depth_m=np.full(shape, 2.0, dtype=np.float32),
            encoding="16UC1",
        )
        topic = f"/{name}/depth/image_raw"
        self._add(received_ns, lambda writer: writer.write_depth(topic, image))

    def info(self, name: str = "camera", lens: CameraIntrinsics | None = INTRINSICS):
        info = CameraInfo(
            stamp_ns=START_NS, received_ns=START_NS, frame_id=f"{name}_optical", intrinsics=lens
        )
        topic = f"/{name}/depth/camera_info"
        self._add(START_NS, lambda writer: writer.write_camera_info(topic, info))

    def transform(
        self, parent: str, child: str, T_parent_child: np.ndarray, at_ms: float | None = None
    ):
        """On /tf_static, or on /tf where there is a time."""
        stamp_ns, received_ns = _stamps(at_ms or 0.0, 0.0)
        entry = Transform(
            stamp_ns=stamp_ns, parent=parent, child=child, T_parent_child=T_parent_child.copy()
        )
        batch = TransformBatch(received_ns=received_ns, transforms=(entry,))
        topic = "/tf_static" if at_ms is None else "/tf"
        self._add(received_ns, lambda writer: writer.write_transforms(topic, batch))

    def pose(
        self, topic: str, at_ms: float, T: np.ndarray, *, child: str = "", parent: str = "odom"
    ):
        """Odometry where there is a child frame, else a PoseStamped."""
        stamp_ns, received_ns = _stamps(at_ms, 0.0)
        sample = PoseSample(
            stamp_ns=stamp_ns,
            received_ns=received_ns,
            parent=parent,
            child=child,
            T_parent_child=T.copy(),
        )
        self._add(received_ns, lambda writer: writer.write(topic, sample, odometry=child != ""))

    def open(self) -> Recording:
        with Ros2McapWriter(self.path) as writer:
            for _, write in sorted(self._writes, key=lambda entry: entry[0]):
                write(writer)
        self._opened.append(open_recording(self.path))
        return self._opened[-1]

    def close(self) -> None:
        for recording in self._opened:
            recording.close()


def _stamps(at_ms: float, late_ms: float) -> tuple[int, int]:
    stamp_ns = START_NS + round(at_ms * NS_PER_MS)
    return stamp_ns, stamp_ns + round(late_ms * NS_PER_MS)


@pytest.fixture
def log(tmp_path: Path) -> Iterator[Log]:
    """An empty recording to be filled."""
    filled = Log(tmp_path / "small.mcap")
    yield filled
    filled.close()


@pytest.fixture
def new_log(tmp_path_factory: pytest.TempPathFactory) -> Callable[[], Log]:
    """A new empty recording at each call, for the examples of a property."""
    return lambda: Log(tmp_path_factory.mktemp("log") / "small.mcap")


@pytest.fixture(scope="session")
def pose_of() -> Callable[..., np.ndarray]:
    """(4, 4) of a body at x, y, z that looks along yaw, pitch, roll; ``optical`` for its axes."""

    def pose(x=0.0, y=0.0, z=0.0, *, yaw=0.0, pitch=0.0, roll=0.0, optical=False) -> np.ndarray:
        rotation = rotation_from_yaw_pitch_roll(yaw, pitch, roll)
        return make_transform(rotation @ OPTICAL if optical else rotation, np.array([x, y, z]))

    return pose


@dataclass(frozen=True)
class Fused:
    """A simulated recording, its truth, and the folder that it was fused into."""

    recording: Path
    truth: Path
    folder: Path
    summary: FuseSummary


@pytest.fixture(scope="session")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Writes a scene of 3 s with images of half size, unless told; each once a session."""
    folder = tmp_path_factory.mktemp("scenes")

    def scene(name: str, *, duration_s: float = 3.0, image_scale: float = 0.5) -> Path:
        path = folder / f"{name}_{duration_s:g}_{image_scale:g}.mcap"
        if not path.exists():
            own = find_scene(name).settings.model_dump()
            given = own | {"duration_s": duration_s, "image_scale": image_scale}
            write_scene(name, path, settings=SceneSettings(**given))
        return path

    return scene


@pytest.fixture(scope="session")
def fused(
    scenes: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., Fused]:
    """Fuses a scene with the options given, into a new folder, without figures."""

    def run(name: str, *, duration_s: float = 3.0, **options) -> Fused:
        recording = scenes(name, duration_s=duration_s)
        folder = tmp_path_factory.mktemp("fused") / "results"
        summary = fuse(recording, folder, FuseOptions(figures=False, **options))
        truth = recording.with_name(f"{recording.stem}.truth.npz")
        return Fused(recording=recording, truth=truth, folder=folder, summary=summary)

    return run


@pytest.fixture(scope="session")
def bedroom(fused: Callable[..., Fused]) -> Fused:
    """One camera, its mount and the robot's motion in TF."""
    return fused("bedroom")


@pytest.fixture(scope="session")
def panorama(fused: Callable[..., Fused]) -> Fused:
    """Four rolled cameras, the LiDAR's mount unknown."""
    return fused("robot_at_home", duration_s=2.0)
