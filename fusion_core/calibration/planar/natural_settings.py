"""Settings of the calibration of a 2D LiDAR and a depth camera without a board."""

from fusion_core.model.seeds import SEED_MAX
from fusion_core.settings import StageSettings, setting


class NaturalSettings(StageSettings):
    """How walls and floor are used, and what is called observable."""

    frames: int = setting(60, "Depth images used, evenly spread", unit="images", ge=8, le=400)
    patches: int = setting(
        700, "Most surface patches used of an image", unit="patches", ge=50, le=10_000
    )
    start_angle_sd_deg: float = setting(
        10.0, "Doubt of the angles that the fit starts from", unit="deg", ge=0.1, le=45.0
    )
    start_place_sd_m: float = setting(
        1.0, "Doubt of the place that the fit starts from", unit="m", ge=0.01, le=10.0
    )
    up_sd_m: float = setting(
        0.2, "Doubt of the height between camera and LiDAR in a guess", unit="m", ge=1e-3, le=5.0
    )
    lidar_height_m: float | None = setting(
        None,
        "Height of the LiDAR's plane above the floor, where it was measured: it makes the height "
        "between camera and LiDAR observable",
        unit="m",
        ge=0.0,
        le=5.0,
    )
    lidar_height_sd_m: float = setting(
        0.005, "Doubt of a measured height of the LiDAR", unit="m", ge=1e-4, le=1.0
    )
    # TurtleBot to Robot@Home: 0.1 to 0.5 m.
    assumed_lidar_height_m: float = setting(
        0.3,
        "Height of the LiDAR above the floor that is assumed where nothing is known",
        unit="m",
        ge=0.0,
        le=5.0,
    )
    assumed_lidar_height_sd_m: float = setting(
        0.2, "Doubt of an assumed height of the LiDAR", unit="m", ge=1e-2, le=5.0
    )
    lidar_level_sd_deg: float = setting(
        0.0,
        "Doubt of a LiDAR that sweeps parallel to the floor: its tilt, which no wall shows",
        unit="deg",
        ge=0.0,
        le=10.0,
    )
    # "Depth accuracy: <= 2 % at 2 m", Intel RealSense D400 data sheet.
    depth_scale_sd: float = setting(
        0.02, "Doubt of the depth images' scale, as a fraction", ge=1e-6, le=0.2
    )
    # Scanners of robots state 10 to 30 mm for single ranges, most of it noise.
    range_offset_sd_m: float = setting(
        0.005, "Doubt of the LiDAR's ranges, by one offset", unit="m", ge=1e-5, le=0.2
    )
    clock_sd_ms: float = setting(
        80.0, "Doubt of stamps that are of one clock", unit="ms", ge=1e-3, le=1e4
    )
    observable_sd_deg: float = setting(
        0.15, "Greatest standard deviation of an observable angle", unit="deg", ge=1e-3, le=10.0
    )
    observable_sd_m: float = setting(
        0.015, "Greatest standard deviation of an observable length", unit="m", ge=1e-4, le=1.0
    )
    held_out_blocks: int = setting(
        6, "Blocks of frames, each held out once", unit="blocks", ge=3, le=50
    )
    basin_starts: int = setting(
        8, "Disturbed starts by which the basin is tried (0: none)", unit="starts", ge=0, le=200
    )
    basin_angle_deg: float = setting(
        5.0, "How far a start's angles are disturbed", unit="deg", ge=0.0, le=90.0
    )
    basin_place_m: float = setting(
        0.1, "How far a start's place is disturbed", unit="m", ge=0.0, le=5.0
    )
    seed: int = setting(0, "Seed of the disturbed starts", ge=0, le=SEED_MAX)
