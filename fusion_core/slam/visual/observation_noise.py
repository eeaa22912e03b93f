"""How far a feature's pixel and depth may be off: the weights of every adjustment."""

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.visual.features import octave_scales

CHI2_PIXEL = 5.991
"""95 % of the squared, normalised error of u and v alone."""
CHI2_DEPTH = 7.815
"""95 % of that of u, v and depth."""
CHI2_POSE = 12.592
"""95 % of that of a relative pose."""


class ObservationNoise(StageSettings):
    """Noise of an observation: u, v and depth.

    ORB-SLAM2 (2017, §III-A) turns a depth z into the column u_r = u - f b / z that a second camera
    at a baseline b would see. With independent errors of pixel and depth the same is said by u, v
    and 1 / z: a depth with a standard deviation a z² has an inverse with a standard deviation a,
    whatever its distance, and b drops out.
    """

    pixel_sigma: float = setting(
        1.0,
        "Standard deviation of a feature's image coordinates on the finest level",
        unit="px",
        ge=1e-3,
        le=10.0,
    )
    depth_sigma_per_m2: float = setting(
        0.003, "Standard deviation of a depth over its square", unit="1/m", ge=1e-6, le=1.0
    )

    def pixel_sigmas(self, octaves: IntArray) -> FloatArray:
        """(N,) px of features on levels of the pyramid, (N,)."""
        return self.pixel_sigma * octave_scales(octaves)
