"""The rig's tilt against the room, which the LiDAR sweeps level."""

from dataclasses import dataclass

# Of a 95 % interval.
_SIGNIFICANT_SD = 1.96
# More images have the same errors.
_IMAGES = 24


@dataclass(frozen=True, slots=True, kw_only=True)
class RigTilt:
    """Tilt of the rig, R = Ry(pitch) Rx(roll), with standard deviations: pitch is positive where it
    looks down, roll where its left side is raised. ``height_m``: of the rig's origin above the
    floor, None where the tilt is that of walls, and no floor is seen."""

    pitch_rad: float
    pitch_sd_rad: float
    roll_rad: float
    roll_sd_rad: float
    height_m: float | None

    @property
    def is_rolled(self) -> bool:
        """Whether the roll differs from that of a level rig by more than its 95 % interval."""
        return abs(self.roll_rad) > _SIGNIFICANT_SD * self.roll_sd_rad


def images_for_tilt(count: int) -> range:
    """Indices of the images to find it from, evenly spread over ``count``."""
    return range(0, count, max(1, count // _IMAGES))
