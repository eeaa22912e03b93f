"""A map as ROS's map_server and nav2 read it: a grey picture and a YAML file beside it."""

from pathlib import Path

import numpy as np

from fusion_core.files.atomic import write_bytes, write_text
from fusion_core.model.conventions import ByteArray
from fusion_core.model.grids import OccupancyGrid

OCCUPIED_PIXEL = 0
FREE_PIXEL = 254
UNKNOWN_PIXEL = 205

# By default a cell is drawn as occupied or free with these probabilities, and as unknown between.
OCCUPIED_ABOVE = 0.65
FREE_BELOW = 0.25

# The reader compares (255 - pixel) / 255 with the thresholds of the YAML file, and pixel 205 gives
# 0.19608: with 0.25 it would read unknown cells as free. 0.65 and 0.196 separate the three pixel
# values, whatever the thresholds by which the cells were classified.
_YAML_OCCUPIED_THRESH = 0.65
_YAML_FREE_THRESH = 0.196


def write_ros_map(
    folder: Path,
    name: str,
    grid: OccupancyGrid,
    *,
    occupied_above: float = OCCUPIED_ABOVE,
    free_below: float = FREE_BELOW,
) -> tuple[Path, Path]:
    """Write ``name.pgm`` and ``name.yaml`` (mode trinary) and return their paths.

    A cell is occupied where its probability exceeds ``occupied_above``, free where it is less than
    ``free_below``, unknown otherwise.
    """
    pixels = trinary_pixels(grid, occupied_above=occupied_above, free_below=free_below)
    rows, columns = pixels.shape
    image = folder / f"{name}.pgm"
    write_bytes(image, f"P5\n{columns} {rows}\n255\n".encode("ascii") + pixels.tobytes())
    yaml = folder / f"{name}.yaml"
    x_m, y_m = (round(value, 9) for value in grid.origin_m)
    write_text(
        yaml,
        f"image: {image.name}\n"
        "mode: trinary\n"
        f"resolution: {grid.resolution_m}\n"
        f"origin: [{x_m}, {y_m}, 0.0]\n"
        "negate: 0\n"
        f"occupied_thresh: {_YAML_OCCUPIED_THRESH}\n"
        f"free_thresh: {_YAML_FREE_THRESH}\n",
    )
    return image, yaml


def trinary_pixels(
    grid: OccupancyGrid, *, occupied_above: float = OCCUPIED_ABOVE, free_below: float = FREE_BELOW
) -> ByteArray:
    """(rows, columns) grey values; row 0 is the largest y, as in a picture."""
    probability = grid.probability
    pixels = np.full(probability.shape, UNKNOWN_PIXEL, dtype=np.uint8)
    pixels[probability > occupied_above] = OCCUPIED_PIXEL
    pixels[probability < free_below] = FREE_PIXEL
    return np.ascontiguousarray(np.flipud(pixels))
