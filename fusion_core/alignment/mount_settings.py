"""How the mount is refined, and what is held of it before the data."""

from dataclasses import dataclass, replace

import numpy as np

from fusion_core.model.conventions import FloatArray, read_only
from fusion_core.model.rig import Mount
from fusion_core.settings import StageSettings, setting

# The rows' yaw, which a sample a degree and rows that are not the LiDAR's make uncertain.
_PRIOR_YAW_SD_RAD = np.deg2rad(10.0)


class MountSettings(StageSettings):
    """How the mount is refined around the recording's offset u."""

    # The images and two copies of them, at 640 x 480 pixels 0.7 GB.
    frames: int = setting(48, "Depth images kept for the refinement", unit="images", ge=4, le=200)
    tolerance_m: float = setting(0.03, "Agreement tolerance at range 0", unit="m", ge=1e-6, le=2.0)
    tolerance_fraction: float = setting(
        0.02,
        "Growth of the agreement tolerance with range, as a fraction of it",
        ge=1e-6,
        le=0.2,
        formerly="tolerance_share",
    )
    occlusion_cost: float = setting(
        0.6,
        "Cost of a LiDAR point that something nearer may occlude, in parts of that of one with "
        "depth beyond it; where agreement is counted, too",
        ge=0.0,
        le=1.0,
        formerly="nearer_cost",
    )
    no_depth_cost: float = setting(
        0.3,
        "Cost of a LiDAR point above or below the image, or on a hole",
        ge=0.0,
        le=1.0,
        formerly="hidden_cost",
    )
    # Every 5 cm between the two is tried, all around; no robot is taller.
    delta_z_min_m: float = setting(
        -0.8, "Lowest camera against the LiDAR", unit="m", ge=-5.0, le=5.0
    )
    delta_z_max_m: float = setting(
        1.6, "Highest camera against the LiDAR", unit="m", ge=-5.0, le=5.0
    )
    clearance_m: float = setting(
        0.1,
        "Least height of the LiDAR's plane over the lowest surface seen",
        unit="m",
        ge=0.0,
        le=5.0,
    )
    frame_yaw_sd_deg: float = setting(
        0.5,
        "How far a frame's yaw may stray from the mount's (0: not at all)",
        unit="deg",
        ge=0.0,
        le=30.0,
    )
    prior_delta_z_sd_m: float = setting(
        1.0,
        "Doubt of the camera's height over the LiDAR, where none is recorded and no floor is seen",
        unit="m",
        ge=1e-3,
        le=10.0,
    )
    # TurtleBot to Robot@Home: 0.1 to 0.5 m.
    assumed_lidar_height_m: float = setting(
        0.3,
        "Height of the LiDAR above the floor that is assumed where no mount is recorded; where no "
        "floor is seen, its greatest above the lowest surface seen",
        unit="m",
        ge=0.0,
        le=5.0,
    )
    assumed_lidar_height_sd_m: float = setting(
        0.2, "Doubt of an assumed height of the LiDAR", unit="m", ge=1e-2, le=5.0
    )
    prior_arm_sd_m: float = setting(
        0.15,
        "Doubt of a camera straight above the LiDAR, where no mount is recorded",
        unit="m",
        ge=1e-3,
        le=10.0,
    )
    prior_pitch_sd_deg: float = setting(
        5.0, "Doubt of a level camera, where no mount is recorded", unit="deg", ge=1e-3, le=45.0
    )
    prior_clock_sd_ms: float = setting(
        80.0, "Doubt of stamps that are of one clock", unit="ms", ge=1e-3, le=1e4
    )
    # "Depth accuracy: <= 2 % at 2 m", Intel RealSense D400 data sheet.
    depth_scale_sd: float = setting(
        0.02, "Doubt of the depth images' scale, as a fraction", ge=1e-6, le=0.2
    )
    recorded_angle_sd_deg: float = setting(
        0.3, "Doubt of a recorded mount's yaw and pitch", unit="deg", ge=1e-3, le=45.0
    )
    recorded_position_sd_m: float = setting(
        0.01, "Doubt of a recorded mount's position", unit="m", ge=1e-4, le=10.0
    )
    min_agreement: float = setting(
        0.8, "Least fraction of visible points that agree, to pair along the curve", ge=1e-6, le=1.0
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class MountPriors:
    """What is held of the mount before the data: ``centre`` and ``sd``, (6,) as MOUNT_PARAMETERS;
    infinite where nothing is. ``stretch_sd``: of the fraction by which depths are too long.
    ``higher_sd_m``: of a Delta z above the centre, None where it is the same as below."""

    centre: FloatArray
    sd: FloatArray
    stretch_sd: float
    higher_sd_m: float | None = None

    def __post_init__(self) -> None:
        read_only(self.centre)
        read_only(self.sd)

    def with_pitch(self, pitch_rad: float, sd_rad: float) -> "MountPriors":
        """The same with another doubt of the pitch."""
        return self._with(4, pitch_rad, sd_rad)

    def with_height(
        self, delta_z_m: float, sd_m: float, higher_sd_m: float | None = None
    ) -> "MountPriors":
        """The same with another doubt of the height."""
        return replace(self._with(1, delta_z_m, sd_m), higher_sd_m=higher_sd_m)

    def with_yaw(self, yaw_rad: float) -> "MountPriors":
        """The same around another yaw."""
        return self._with(0, yaw_rad, float(self.sd[0]))

    def _with(self, index: int, centre: float, sd: float) -> "MountPriors":
        centres, sds = self.centre.copy(), self.sd.copy()
        centres[index], sds[index] = centre, sd
        return replace(self, centre=centres, sd=sds)

    def squares(self, values: FloatArray) -> FloatArray:
        """(..., 6) squared differences of mounts from the centre, in squared deviations."""
        off = values - self.centre
        z = off / self.sd
        if self.higher_sd_m is not None:
            z[..., 1] = np.where(off[..., 1] > 0.0, off[..., 1] / self.higher_sd_m, z[..., 1])
        squares: FloatArray = z**2
        return squares

    def with_drawn_height_and_pitch(self, rng: np.random.Generator) -> "MountPriors":
        """The same around a height and a pitch that are drawn from them."""
        draw = np.zeros(self.sd.size)
        draw[[1, 4]] = rng.normal(size=2)
        off = draw * np.where(np.isfinite(self.sd), self.sd, 0.0)
        if self.higher_sd_m is not None and draw[1] > 0.0:
            off[1] = draw[1] * self.higher_sd_m
        return replace(self, centre=self.centre + off)

    @classmethod
    def without_recorded(cls, yaw_rad: float, settings: MountSettings) -> "MountPriors":
        """Around a compact, level rig whose yaw is nearly known."""
        arm_m = settings.prior_arm_sd_m
        sd = [
            _PRIOR_YAW_SD_RAD,
            settings.prior_delta_z_sd_m,
            arm_m,
            arm_m,
            np.deg2rad(settings.prior_pitch_sd_deg),
            settings.prior_clock_sd_ms,
        ]
        centre = np.array([yaw_rad, 0.0, 0.0, 0.0, 0.0, 0.0])
        return cls(centre=centre, sd=np.array(sd), stretch_sd=settings.depth_scale_sd)

    @classmethod
    def around(cls, mount: Mount, settings: MountSettings) -> "MountPriors":
        """Around a mount that may be wrong, with the doubt of one of which nothing is known."""
        unknown = cls.without_recorded(mount.yaw_rad, settings)
        return cls(centre=mount.vector(), sd=unknown.sd.copy(), stretch_sd=unknown.stretch_sd)

    @classmethod
    def from_recorded(cls, recorded: Mount, settings: MountSettings) -> "MountPriors":
        """Around a mount from a drawing or a calibration, which knows no clock."""
        angle_rad = float(np.deg2rad(settings.recorded_angle_sd_deg))
        place_m = settings.recorded_position_sd_m
        sd = [angle_rad, place_m, place_m, place_m, angle_rad, settings.prior_clock_sd_ms]
        return cls(centre=recorded.vector(), sd=np.array(sd), stretch_sd=settings.depth_scale_sd)
