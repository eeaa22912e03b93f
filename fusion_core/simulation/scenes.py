"""The synthetic scenes by name, and how a run is planned from a scene and its settings."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from fusion_core.model.errors import SettingsError
from fusion_core.model.progress import Progress, silent
from fusion_core.model.seeds import SEED_MAX
from fusion_core.settings import StageSettings, setting
from fusion_core.simulation import (
    arena,
    buildings,
    office,
    sensor_mounts,
    twin_rooms,
    worlds,
)
from fusion_core.simulation.depth_camera import DepthNoise
from fusion_core.simulation.faults import FaultSettings, KidnappedPath
from fusion_core.simulation.lidar import LidarNoise
from fusion_core.simulation.odometry import OdometryNoise
from fusion_core.simulation.paths import RobotPath, WeavingPath
from fusion_core.simulation.random_streams import RandomStream, make_generator
from fusion_core.simulation.recorder import PublishedMounts, SimulatedRun, record_run
from fusion_core.simulation.room_features import add_features
from fusion_core.simulation.sensor_mounts import SensorMounts
from fusion_core.simulation.sensor_simulator import SimulationSetup
from fusion_core.simulation.worlds import World

SPEED_M_S = 0.3

# Li 2022, Table 1: within 1 % of the range up to 3 m, 2 % to 5 m, 2.5 % beyond. Read as a bound
# of three standard deviations.
RPLIDAR_A1 = LidarNoise(
    sigma_near_m=0.0017,
    relative_sigma=0.01 / 3.0,
    relative_sigma_middle=0.02 / 3.0,
    relative_sigma_far=0.025 / 3.0,
    # Our choice: a tenth of the URG's.
    spurious_fraction=0.0005,
    spike_fraction=0.0,
    corner_bias_m=0.0,
)
# Li 2022, Table 2: within 1-3 mm at 1 m, growing with z². Read as three standard deviations of
# 1 mm, split between the quantisation of the inverse depth and the noise before it.
ASTRA_PRO = DepthNoise(
    sigma_per_m=0.87e-3,
    disparity_step_per_m=1.7e-3,
    near_m=0.6,
    far_m=8.0,
    speckles=8.0,
    glass_front_fraction=0.0,
    glass_through_fraction=0.0,
    spike_fraction=0.0,
    corner_bias_m=0.0,
)
# Li 2022, Table 5: 0.23 % of the distance for the old odometer.
TURTLEBOT_ODOMETRY = OdometryNoise(
    distance_scale=1.0023,
    yaw_drift_rad_per_s=0.0005,
    relative_distance_sigma=0.01,
    relative_yaw_sigma=0.02,
)
# Wheels so worn that a map without loop closure shows double walls.
WORN_ODOMETRY = OdometryNoise(distance_scale=1.015, yaw_drift_rad_per_s=0.002)

# Our choice, of 255: what a small colour sensor shows in a room by day.
COLOR_SIGMA = 2.0


class SceneSettings(StageSettings):
    """What a user may change about a scene."""

    seed: int = setting(1, "Decides the world, the path and the noise", ge=0, le=SEED_MAX)
    duration_s: float = setting(8.0, "Length of the recording", unit="s", ge=1e-6, le=3600.0)
    camera_rate_hz: float = setting(
        15.0, "Images a second, of each camera", unit="Hz", ge=1e-6, le=120.0
    )
    image_scale: float = setting(1.0, "Pixels a side, relative to the camera's own", ge=0.1, le=2.0)
    mirror: bool = setting(False, "A mirror hangs on a free wall")
    sunlight: bool = setting(False, "The sun shines through the windows")
    person: bool = setting(False, "A person walks to and fro where the floor is free")
    lidar_skew: bool = setting(False, "The robot moves during a sweep")
    rolling_s: float = setting(
        0.0,
        "Time from the first to the last row of a depth image, while the robot moves (the infrared"
        " imager of a Kinect reads row by row, most of 1/30 s: Ringaby & Forssen 2011)",
        unit="s",
        ge=0.0,
        le=1.0,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedScene:
    """A named scene with its default settings.

    ``published_mounts`` and ``clock_offset_ms`` are those of ``SimulatedRun``; ``speed_m_s``,
    ``start``, ``weave_m`` and ``wavelength_m`` those of ``WeavingPath``. A ``start`` of None is
    drawn from the seed. ``color_sigma``: that of ``SimulationSetup``.
    """

    name: str
    description: str
    world: Callable[[int], World]
    mounts: Callable[[], SensorMounts]
    settings: SceneSettings
    published_mounts: PublishedMounts = "none"
    clock_offset_ms: float = 0.0
    speed_m_s: float = SPEED_M_S
    start: float | None = None
    weave_m: float = WeavingPath.WEAVE_M
    wavelength_m: float = WeavingPath.WAVELENGTH_M
    lidar_noise: LidarNoise = field(default_factory=LidarNoise)
    depth_noise: DepthNoise = field(default_factory=DepthNoise)
    odometry_noise: OdometryNoise = field(default_factory=OdometryNoise)
    color_sigma: float = 0.0


_SCENES = (
    SimulatedScene(
        name="furnished_room",
        description="A living room with glass, sunlight, low boxes and tables; mount unknown",
        world=worlds.furnished_room,
        mounts=sensor_mounts.home_robot,
        settings=SceneSettings(seed=173, duration_s=6.0, sunlight=True),
    ),
    SimulatedScene(
        name="corridor",
        description="An open corridor, farther than the LiDAR reaches; mount unknown",
        world=worlds.open_corridor,
        mounts=sensor_mounts.home_robot,
        settings=SceneSettings(seed=2),
    ),
    SimulatedScene(
        name="bedroom",
        description="A small cluttered bedroom; /tf_static gives the mount",
        world=worlds.bedroom,
        mounts=sensor_mounts.home_robot,
        settings=SceneSettings(seed=9),
        published_mounts="all",
    ),
    SimulatedScene(
        name="turtlebot_high",
        description="Two rooms with a door; a camera at 0.96 m over a LiDAR at 0.25 m",
        world=worlds.two_rooms,
        mounts=sensor_mounts.turtlebot_high,
        settings=SceneSettings(seed=4),
        published_mounts="all",
    ),
    SimulatedScene(
        name="turtlebot_low",
        description="Two rooms with a door; a camera at 0.25 m under a LiDAR at 0.31 m",
        world=worlds.two_rooms,
        mounts=sensor_mounts.turtlebot_low,
        settings=SceneSettings(seed=5),
        published_mounts="all",
    ),
    SimulatedScene(
        name="robot_at_home",
        description="A living room seen by four cameras in portrait; the LiDAR's mount unknown",
        world=worlds.furnished_room,
        mounts=sensor_mounts.robot_at_home,
        settings=SceneSettings(seed=6, camera_rate_hz=10.72, sunlight=True),
        published_mounts="cameras",
    ),
    SimulatedScene(
        name="clock_offset",
        description="A living room; the camera's stamps are 40 ms late; /tf_static gives the mount",
        world=worlds.furnished_room,
        mounts=sensor_mounts.home_robot,
        settings=SceneSettings(seed=7),
        published_mounts="all",
        clock_offset_ms=40.0,
    ),
    SimulatedScene(
        name="moving_person",
        description="A living room in which a person walks to and fro; /tf_static gives the mount",
        world=worlds.room_with_person,
        mounts=sensor_mounts.home_robot,
        settings=SceneSettings(seed=4),
        published_mounts="all",
    ),
    SimulatedScene(
        name="hard_room",
        description="A living room with a mirror, sunlight and a person; rows exposed in turn",
        world=worlds.furnished_room,
        mounts=sensor_mounts.home_robot,
        settings=SceneSettings(
            seed=12, mirror=True, sunlight=True, person=True, lidar_skew=True, rolling_s=0.03
        ),
    ),
    SimulatedScene(
        name="arena",
        description="The site of Li 2022, 5.6 m x 3.18 m: objects that one sensor alone sees",
        world=arena.arena,
        mounts=sensor_mounts.turtlebot2,
        settings=SceneSettings(duration_s=75.0, camera_rate_hz=7.0),
        published_mounts="all",
        start=0.0,
        weave_m=0.05,
        lidar_noise=RPLIDAR_A1,
        depth_noise=ASTRA_PRO,
        odometry_noise=TURTLEBOT_ODOMETRY,
    ),
    SimulatedScene(
        name="two_room_loop",
        description="Three rounds through two rooms with two doors; the odometry drifts",
        world=buildings.two_room_loop,
        mounts=sensor_mounts.turtlebot2_short,
        settings=SceneSettings(seed=3, duration_s=150.0, camera_rate_hz=4.0, image_scale=0.5),
        published_mounts="all",
        speed_m_s=0.5,
        start=0.0,
        weave_m=0.04,
        wavelength_m=2.0,
        lidar_noise=RPLIDAR_A1,
        depth_noise=ASTRA_PRO,
        odometry_noise=WORN_ODOMETRY,
    ),
    SimulatedScene(
        name="floor",
        description="A corridor and six rooms, visited one by one; the odometry drifts",
        world=buildings.whole_floor,
        mounts=sensor_mounts.turtlebot2,
        settings=SceneSettings(seed=3, duration_s=200.0, camera_rate_hz=3.0, image_scale=0.5),
        published_mounts="all",
        speed_m_s=0.6,
        start=0.0,
        weave_m=0.04,
        wavelength_m=2.0,
        lidar_noise=RPLIDAR_A1,
        depth_noise=ASTRA_PRO,
        odometry_noise=WORN_ODOMETRY,
    ),
    SimulatedScene(
        name="office",
        description="An office after Fu 2024, 8.4 m x 6.6 m: painted, low things on the floor",
        world=office.office,
        mounts=sensor_mounts.office_robot,
        # The paper's camera gives 7 depth images a second.
        settings=SceneSettings(duration_s=84.0, camera_rate_hz=7.0),
        published_mounts="all",
        # Once round both blocks of desks takes 80 s.
        speed_m_s=0.35,
        start=0.0,
        weave_m=0.05,
        lidar_noise=RPLIDAR_A1,
        depth_noise=ASTRA_PRO,
        odometry_noise=TURTLEBOT_ODOMETRY,
        color_sigma=COLOR_SIGMA,
    ),
    SimulatedScene(
        name="twin_rooms",
        description="Two rooms alike in shape and paint on a corridor: only the way tells them",
        world=twin_rooms.twin_rooms,
        mounts=sensor_mounts.office_robot,
        settings=SceneSettings(duration_s=100.0, camera_rate_hz=7.0),
        published_mounts="all",
        # Through both rooms and back takes 88 s.
        speed_m_s=0.4,
        start=0.1,
        weave_m=0.03,
        lidar_noise=RPLIDAR_A1,
        depth_noise=ASTRA_PRO,
        odometry_noise=TURTLEBOT_ODOMETRY,
        color_sigma=COLOR_SIGMA,
    ),
)


def list_scenes() -> tuple[SimulatedScene, ...]:
    """Every scene, in the order of the documentation."""
    return _SCENES


def find_scene(name: str) -> SimulatedScene:
    """The scene of that name. Raises SettingsError where there is none."""
    for scene in _SCENES:
        if scene.name == name:
            return scene
    known = ", ".join(scene.name for scene in _SCENES)
    raise SettingsError(f"there is no scene {name!r}.", advice=f"Choose one of: {known}.")


def write_scene(
    name: str,
    path: Path,
    *,
    settings: SceneSettings | None = None,
    faults: FaultSettings | None = None,
    progress: Progress = silent,
) -> None:
    """Write a scene as a ROS 2 MCAP file, and ``NAME.truth.npz`` and ``NAME.world.json`` beside it.

    ``settings`` are the scene's own where None, and there are no ``faults`` where None. The same
    settings give the same bytes. Raises SettingsError for an unknown scene, ExportError where a
    file cannot be written.
    """
    scene = find_scene(name)
    own = scene.settings if settings is None else settings
    record_run(plan_run(scene, own, FaultSettings() if faults is None else faults), path, progress)


def plan_run(scene: SimulatedScene, settings: SceneSettings, faults: FaultSettings) -> SimulatedRun:
    """Everything that determines the recording of a scene."""
    world = add_features(
        scene.world(settings.seed),
        settings.seed,
        mirror=settings.mirror,
        sunlight=settings.sunlight,
        person=settings.person,
    )
    start = scene.start
    if start is None:
        start = float(make_generator(settings.seed, RandomStream.PATH).random())
    path = WeavingPath(
        world.route_m,
        speed_m_s=scene.speed_m_s,
        start=start,
        weave_m=scene.weave_m,
        wavelength_m=scene.wavelength_m,
    )
    drive: RobotPath = path
    if faults.kidnap_at_s is not None:
        drive = KidnappedPath(path, at_s=faults.kidnap_at_s, ahead_m=faults.kidnap_ahead_m)
    simulation = SimulationSetup(
        world=world,
        mounts=scene.mounts().scaled(settings.image_scale),
        path=drive,
        seed=settings.seed,
        lidar_skew=settings.lidar_skew,
        rolling_s=settings.rolling_s,
        lidar_noise=scene.lidar_noise,
        depth_noise=scene.depth_noise,
        color_sigma=scene.color_sigma,
    )
    return SimulatedRun(
        simulation=simulation,
        duration_s=settings.duration_s,
        camera_rate_hz=settings.camera_rate_hz,
        published_mounts=scene.published_mounts,
        clock_offset_ms=scene.clock_offset_ms,
        odometry_noise=scene.odometry_noise,
        faults=faults,
    )
