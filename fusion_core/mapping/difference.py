"""Where two or three maps of one place differ."""

from collections.abc import Mapping

import numpy as np

from fusion_core.mapping.canvas import pad_to_common_canvas
from fusion_core.model.grids import MapDifference, OccupancyGrid


def compare_maps(
    grids: Mapping[str, OccupancyGrid], *, occupied_probability: float = 0.65
) -> MapDifference:
    """Compare maps, given by name, on the smallest canvas that covers all of them.

    A cell is occupied in a map where its probability exceeds ``occupied_probability``. Raises
    ValueError unless there are two or three maps in one frame, on one raster.
    """
    if len(grids) not in (2, 3):
        raise ValueError(f"two or three maps are compared, got {len(grids)}")
    laid = list(pad_to_common_canvas(grids).values())
    first = laid[0]
    known = np.any([grid.known for grid in laid], axis=0)
    occupied_in = np.zeros(first.log_odds.shape, dtype=np.uint8)
    for i, grid in enumerate(laid):
        # NaN compares false.
        occupied_in |= (grid.probability > occupied_probability).astype(np.uint8) << i
    return MapDifference(
        names=tuple(grids),
        resolution_m=first.resolution_m,
        origin_m=first.origin_m,
        states=np.where(known, MapDifference.FREE + occupied_in, MapDifference.UNKNOWN).astype(
            np.uint8
        ),
    )
