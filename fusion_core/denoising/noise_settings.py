"""The settings of the noise classes."""

from typing import Literal

from fusion_core.settings import StageSettings, setting


class NoiseSettings(StageSettings):
    """The threshold epsilon and what counts as support by neighbours."""

    epsilon: float = setting(
        2.6,
        "A beam and its pixel that differ by more are noise: ε of eq. (6), in epsilon_unit",
        ge=1e-6,
        le=100.0,
    )
    epsilon_unit: Literal["sigma", "E", "m"] = setting(
        "sigma", "Unit of epsilon: the learned noise scale, the frame's mean error E, or metres"
    )
    support_sigma: float = setting(
        2.5, "A neighbour within this many standard deviations supports a beam", ge=1e-6, le=10.0
    )
    slope_fraction: float = setting(
        0.02,
        "Change of range from beam to beam that a slanted wall may cause, where the camera sees "
        "nothing, as a fraction of the range",
        ge=0.0,
        le=0.2,
        formerly="slope_share",
    )
    pixel_tolerance_fraction: float = setting(
        0.03,
        "A neighbouring pixel within 3 cm plus this fraction of the depth supports a pixel",
        ge=0.0,
        le=1.0,
        formerly="pixel_tolerance_share",
    )
    burr_criterion: Literal["support", "rougher"] = setting(
        "support",
        "Which side of a disagreeing pair is a burr: a side without support, or the side that "
        "deviates more from its neighbours (published; there are no conflicts then)",
        formerly="fault",
    )
    burr_odds: float = setting(
        2.0,
        "Odds that a beam is a burr, before its neighbours are asked, if it disagrees with a "
        "camera that sees where it ends; even odds where something hides that from the camera",
        ge=1e-3,
        le=1e3,
    )
    pixel_support: int = setting(
        2, "Pixels of the 5 x 5 around that must support one, else it is a burr", ge=1, le=24
    )
    motion_pixels: int = setting(
        4,
        "How far a surface may have moved in the image since the one before",
        unit="px",
        ge=1,
        le=64,
    )
    pixel_support_fraction: float = setting(
        0.3,
        "Least fraction of the valid pixels around that must support one",
        ge=0.0,
        le=1.0,
        formerly="pixel_support_share",
    )
