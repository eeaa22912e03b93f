"""The synthetic scenes by name: what each is for, and how it is made from its settings."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fusion_core.model.errors import SettingsError
from fusion_core.model.progress import Progress, silent
from fusion_core.settings import StageSettings, setting
from fusion_core.simulation import rigs, worlds
from fusion_core.simulation.observer import Setup
from fusion_core.simulation.paths import WeavingPath
from fusion_core.simulation.randomness import Stream, generator
from fusion_core.simulation.recorder import Extrinsics, Take, record
from fusion_core.simulation.rigs import Rig
from fusion_core.simulation.worlds import World

SPEED_M_S = 0.3


class SceneSettings(StageSettings):
    """What may be changed about a scene."""

    seed: int = setting(1, "Decides the world, the path and the noise", ge=0)
    duration_s: float = setting(8.0, "Length of the recording", unit="s", gt=0.0, le=3600.0)
    camera_rate_hz: float = setting(15.0, "Images a second, of each camera", unit="Hz", gt=0.0)
    image_scale: float = setting(1.0, "Pixels a side, relative to the camera's own", ge=0.1, le=2.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """A named scene with the settings that it has when nothing else is said.

    ``extrinsics`` and ``clock_offset_ms`` are those of ``Take``.
    """

    name: str
    description: str
    world: Callable[[int], World]
    rig: Callable[[], Rig]
    settings: SceneSettings
    extrinsics: Extrinsics = "none"
    clock_offset_ms: float = 0.0


_SCENES = (
    Scene(
        name="furnished_room",
        description="A living room with glass, dark furniture, low boxes and tables; mount unknown",
        world=worlds.furnished_room,
        rig=rigs.home_robot,
        settings=SceneSettings(seed=173, duration_s=6.0),
    ),
    Scene(
        name="corridor",
        description="An open corridor, farther than the LiDAR reaches; mount unknown",
        world=worlds.open_corridor,
        rig=rigs.home_robot,
        settings=SceneSettings(seed=2),
    ),
    Scene(
        name="bedroom",
        description="A small cluttered bedroom; /tf_static gives the mount",
        world=worlds.bedroom,
        rig=rigs.home_robot,
        settings=SceneSettings(seed=9),
        extrinsics="all",
    ),
    Scene(
        name="turtlebot_high",
        description="Two rooms with a door; a camera at 0.96 m over a LiDAR at 0.25 m",
        world=worlds.two_rooms,
        rig=rigs.turtlebot_high,
        settings=SceneSettings(seed=4),
        extrinsics="all",
    ),
    Scene(
        name="turtlebot_low",
        description="Two rooms with a door; a camera at 0.25 m under a LiDAR at 0.31 m",
        world=worlds.two_rooms,
        rig=rigs.turtlebot_low,
        settings=SceneSettings(seed=5),
        extrinsics="all",
    ),
    Scene(
        name="robot_at_home",
        description="A living room seen by four cameras in portrait; the LiDAR's mount unknown",
        world=worlds.furnished_room,
        rig=rigs.robot_at_home,
        settings=SceneSettings(seed=6, camera_rate_hz=10.72),
        extrinsics="cameras",
    ),
    Scene(
        name="clock_offset",
        description="A living room; the camera's stamps are 40 ms late; /tf_static gives the mount",
        world=worlds.furnished_room,
        rig=rigs.home_robot,
        settings=SceneSettings(seed=7),
        extrinsics="all",
        clock_offset_ms=40.0,
    ),
    Scene(
        name="moving_person",
        description="A living room in which a person walks to and fro; /tf_static gives the mount",
        world=worlds.room_with_person,
        rig=rigs.home_robot,
        settings=SceneSettings(seed=4),
        extrinsics="all",
    ),
)


def list_scenes() -> tuple[Scene, ...]:
    """Every scene, in the order of the documentation."""
    return _SCENES


def find_scene(name: str) -> Scene:
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
    progress: Progress = silent,
) -> None:
    """Write a scene as a ROS 2 MCAP file and, beside it, its truth as ``NAME.truth.npz``.

    ``settings`` are the scene's own where None. The same settings give the same bytes. Raises
    SettingsError for an unknown scene, ExportError where a file cannot be written.
    """
    scene = find_scene(name)
    record(take_of(scene, scene.settings if settings is None else settings), path, progress)


def take_of(scene: Scene, settings: SceneSettings) -> Take:
    """What decides the recording of a scene."""
    world = scene.world(settings.seed)
    start = float(generator(settings.seed, Stream.PATH).random())
    setup = Setup(
        world=world,
        rig=scene.rig().scaled(settings.image_scale),
        path=WeavingPath(world.route_m, speed_m_s=SPEED_M_S, start=start),
        seed=settings.seed,
    )
    return Take(
        setup=setup,
        duration_s=settings.duration_s,
        camera_rate_hz=settings.camera_rate_hz,
        extrinsics=scene.extrinsics,
        clock_offset_ms=scene.clock_offset_ms,
    )
