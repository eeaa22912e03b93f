"""What the noise models look at, with everything that is not named harmless."""

import numpy as np

from fusion_core.simulation.depth_camera import DepthView
from fusion_core.simulation.lidar import LidarView

LIMITS = (0.06, 5.6)


def lidar_view(true_m, **changes):
    true_m = np.asarray(true_m, dtype=np.float64)
    no = np.zeros(true_m.shape, dtype=bool)
    parts = {
        "true_m": true_m,
        "incidence_cos": np.ones_like(true_m),
        "glass": no,
        "mirror": no,
        "dark": no,
        "sunlit": no,
        "behind_m": np.full_like(true_m, np.nan),
        "corner_m": np.full_like(true_m, np.inf),
    }
    return LidarView(**{**parts, **changes})


def depth_view(true_m, **changes):
    true_m = np.asarray(true_m, dtype=np.float64)
    no = np.zeros(true_m.shape, dtype=bool)
    parts = {
        "true_m": true_m,
        "incidence_cos": np.ones_like(true_m),
        "glass": no,
        "mirror": no,
        "dark": no,
        "sunlit": no,
        "shadowed": no,
        "behind_m": np.full_like(true_m, np.nan),
        "surface_draw": np.zeros_like(true_m),
        "corner_m": np.full_like(true_m, np.inf),
    }
    return DepthView(**{**parts, **changes})
