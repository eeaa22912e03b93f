"""The noise of depth patches by depth, learned from what a fit leaves."""

from dataclasses import dataclass, field

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.model.robust import robust_sigma

# Assumed before it is learned, at a depth of 0 and per squared depth.
_NOISE_M, _NOISE_PER_M = 0.01, 0.004
_NOISE_BINS = 6
_LEAST_NOISE_M = 1e-3
_OUTLIER_SD = 3.0
# Fewer patches in a bin have no scale.
_MIN_PATCHES = 30


@dataclass(frozen=True, slots=True)
class NoiseCurve:
    """Standard deviation of patches along the ray by depth, learned from residuals."""

    depth_m: FloatArray
    sigma_m: FloatArray

    @classmethod
    def assumed(cls) -> "NoiseCurve":
        """What a depth camera has, before anything is seen."""
        depth_m = np.linspace(0.0, 10.0, 21)
        return cls(depth_m, _assumed_noise_m(depth_m))

    def at(self, depth_m: FloatArray) -> FloatArray:
        """(N,) at depths."""
        sigma: FloatArray = np.interp(depth_m, self.depth_m, self.sigma_m)
        return sigma

    def learn(self, depth_m: FloatArray, value_m: FloatArray) -> "NoiseCurve":
        """The scale of residuals (N,), in bins with as many each."""
        near = np.abs(value_m) < _OUTLIER_SD * self.at(depth_m)
        depth, value = depth_m[near], value_m[near]
        middles, sigmas = [], []
        for own in np.array_split(np.argsort(depth, kind="stable"), _NOISE_BINS):
            if own.size < _MIN_PATCHES:
                continue
            middle = float(np.median(depth[own]))
            # What is twice as far off as is plausible is of other surfaces.
            most = 2.0 * float(_assumed_noise_m(np.array(middle)))
            middles.append(middle)
            sigmas.append(float(np.clip(robust_sigma(value[own]), _LEAST_NOISE_M, most)))
        return NoiseCurve(np.array(middles), np.array(sigmas)) if middles else self


@dataclass(frozen=True, slots=True)
class PatchNoise:
    """Of walls, where the scan's noise takes part, and of the floor."""

    walls: NoiseCurve = field(default_factory=NoiseCurve.assumed)
    floor: NoiseCurve = field(default_factory=NoiseCurve.assumed)

    def at(self, depth_m: FloatArray, is_floor: BoolArray) -> FloatArray:
        """(N,) of each residual."""
        sigma: FloatArray = np.where(is_floor, self.floor.at(depth_m), self.walls.at(depth_m))
        return sigma

    def learn(self, depth_m: FloatArray, value_m: FloatArray, is_floor: BoolArray) -> "PatchNoise":
        """Both from a fit's residuals."""
        return PatchNoise(
            self.walls.learn(depth_m[~is_floor], value_m[~is_floor]),
            self.floor.learn(depth_m[is_floor], value_m[is_floor]),
        )


def _assumed_noise_m(depth_m: FloatArray) -> FloatArray:
    return _NOISE_M + _NOISE_PER_M * depth_m**2
