"""Xu 2024 §2.3.2, eqs. (7), (8): holes and burrs of one sensor repaired from the other.

A LiDAR sample can be had from the camera (the range at which the beam meets what the camera sees,
or the paired pixel mapped back) or from its own good neighbours; a pixel from the LiDAR or from the
plane through its good neighbours in the image. Each takes the source with the smaller expected
error, and says which. Nothing is filled across a depth edge or over too wide a gap.

A repair never removes an obstacle: a valid return is moved farther only where it is a burr of at
least a set confidence, and conflicts are left as they are.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit

from fusion_core.denoising.correspondence import Correspondence
from fusion_core.denoising.noise import Classes
from fusion_core.denoising.noise_scale import NoiseScale
from fusion_core.model.classes import NoiseClass, RepairSource
from fusion_core.model.conventions import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    read_only,
)
from fusion_core.settings import StageSettings, setting


class RepairSettings(StageSettings):
    """Where a repair may come from, and what it may change."""

    prefer: Literal["smaller_error", "other_sensor"] = setting(
        "smaller_error", "Source where there are two; published: always the other sensor"
    )
    max_gap_deg: float = setting(
        8.0, "Widest gap of the LiDAR curve filled from its own neighbours", unit="deg", ge=0.0
    )
    depth_burr_confidence: float = setting(
        0.8, "Least confidence of a burr in the depth image that is repaired", ge=0.0, le=1.0
    )
    lidar_confidence: float = setting(
        0.8, "Least confidence of a good beam from which a pixel is repaired", ge=0.0, le=1.0
    )
    narrow_gap_deg: float = setting(
        1.5,
        "Up to here a gap's own sides are believed against the other sensor",
        unit="deg",
        ge=0.0,
    )
    max_gap_pixels: int = setting(
        24, "Farthest good pixel that a pixel is filled from", unit="px", ge=1, le=100
    )
    edge_m: float = setting(
        0.25, "Sides of a gap farther apart than this are an edge, not a surface", unit="m", gt=0.0
    )
    farther_confidence: float = setting(
        0.7, "Least confidence of a burr that a repair moves farther", ge=0.0, le=1.0
    )
    camera_noise_share: float = setting(
        0.5, "Share of a good pair's noise that is the camera's", gt=0.0, le=1.0
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Repair:
    """Repaired values of the B beams and their pixels; untouched means repaired = raw.

    ``lidar_range_m``: horizontal ranges; ``depth_m``: along the optical axis; NaN where missing
    and not repaired. ``lidar_source``, ``depth_source``: codes of RepairSource.
    """

    lidar_range_m: FloatArray
    lidar_source: IntArray
    depth_m: FloatArray
    depth_source: IntArray

    def __post_init__(self) -> None:
        for array in (self.lidar_range_m, self.lidar_source, self.depth_m, self.depth_source):
            read_only(array)


def repair(
    pairs: Correspondence,
    classes: Classes,
    depth_m: Float32Array,
    scale: NoiseScale,
    settings: RepairSettings,
) -> Repair:
    """Repair the holes and burrs of one frame. ``depth_m``: (H, W) upright view."""
    lidar, lidar_source = _repair_lidar(pairs, classes, scale, settings)
    depth, depth_source = _repair_depth(pairs, classes, depth_m, scale, settings)
    return Repair(
        lidar_range_m=lidar, lidar_source=lidar_source, depth_m=depth, depth_source=depth_source
    )


def _repair_lidar(
    pairs: Correspondence, classes: Classes, scale: NoiseScale, settings: RepairSettings
) -> tuple[FloatArray, IntArray]:
    raw = pairs.lidar_range_m
    burr = classes.lidar_class == NoiseClass.BURR
    if settings.prefer == "smaller_error":
        # What three scans show in one place is kept, whatever its own scan makes of it.
        burr &= ~classes.lidar_steady
    noisy = burr | (classes.lidar_class == NoiseClass.HOLE)
    support = np.isin(classes.lidar_class, (NoiseClass.GOOD, NoiseClass.CONFLICT))
    neighbours, gap_rad = _across_gaps(pairs.azimuth_rad, raw, support, settings.edge_m)
    neighbours = np.where(gap_rad <= np.deg2rad(settings.max_gap_deg), neighbours, np.nan)
    camera = pairs.camera_range_m
    camera_error = settings.camera_noise_share * scale.at(camera)
    # A gap hides structure in proportion to its width; its sides are means of three beams.
    neighbour_error = 0.6 * scale.at(neighbours) + 0.1 * gap_rad * neighbours
    # Where the two contradict each other over a narrow gap, an edge of the camera lies a beam off.
    narrow = gap_rad <= np.deg2rad(settings.narrow_gap_deg)
    contradict = np.abs(camera - neighbours) > 4.0 * scale.at(neighbours)
    doubtful = narrow & contradict & (settings.prefer == "smaller_error")
    camera_error = np.where(doubtful, np.inf, camera_error)
    return _choose(
        raw,
        noisy,
        burr,
        classes.lidar_confidence,
        (camera, camera_error),
        (neighbours, neighbour_error),
        settings,
    )


def _repair_depth(
    pairs: Correspondence,
    classes: Classes,
    depth_m: Float32Array,
    scale: NoiseScale,
    settings: RepairSettings,
) -> tuple[FloatArray, IntArray]:
    raw = pairs.depth_m
    burr = classes.depth_class == NoiseClass.BURR
    burr &= classes.depth_confidence >= settings.depth_burr_confidence
    noisy = burr | (classes.depth_class == NoiseClass.HOLE)
    reliable = classes.lidar_class == NoiseClass.GOOD
    reliable &= classes.lidar_confidence >= settings.lidar_confidence
    lidar = np.where(reliable, pairs.lidar_as_depth_m, np.nan)
    lidar_error = scale.at(lidar)

    def planes_near(expected_m: FloatArray, wanted: BoolArray) -> FloatArray:
        found = np.full((raw.size, 2), np.nan)
        found[wanted] = _image_planes(
            depth_m,
            pairs.row[wanted],
            pairs.column[wanted],
            expected_m[wanted],
            settings.max_gap_pixels,
            settings.edge_m,
        )
        return found

    planes = planes_near(lidar, noisy)
    # Where the image shows nothing at the LiDAR's depth, what it shows may hide that: a table top
    # over the LiDAR's plane. Only something nearer can.
    alone = noisy & ~np.isfinite(planes[:, 0])
    if settings.prefer == "other_sensor":
        alone &= ~np.isfinite(lidar)
    image_only = planes_near(np.full(raw.size, np.nan), alone)
    hides = alone & ~(image_only[:, 0] > lidar - settings.edge_m)
    planes = np.where(hides[:, np.newaxis], image_only, planes)
    lidar = np.where(hides & np.isfinite(image_only[:, 0]), np.nan, lidar)
    return _choose(
        raw,
        noisy,
        burr,
        classes.depth_confidence,
        (lidar, lidar_error),
        (planes[:, 0], planes[:, 1]),
        settings,
    )


def _choose(
    raw: FloatArray,
    noisy: BoolArray,
    burr: BoolArray,
    confidence: FloatArray,
    other: tuple[FloatArray, FloatArray],
    neighbours: tuple[FloatArray, FloatArray],
    settings: RepairSettings,
) -> tuple[FloatArray, IntArray]:
    # A map A may send a value behind the sensor: that is none.
    usable = np.isfinite(other[0]) & (other[0] > 0.0)
    other_error = np.where(usable, other[1], np.inf)
    neighbour_error = np.where(np.isfinite(neighbours[0]), neighbours[1], np.inf)
    better = (other_error <= neighbour_error) | (settings.prefer == "other_sensor")
    from_other = noisy & np.isfinite(other_error) & better
    from_neighbours = noisy & np.isfinite(neighbour_error) & ~from_other
    value = np.where(from_other, other[0], np.where(from_neighbours, neighbours[0], raw))
    source = np.full(raw.size, int(RepairSource.RAW))
    source[from_other] = RepairSource.OTHER_SENSOR
    source[from_neighbours] = RepairSource.NEIGHBOURS
    farther = burr & (value > raw) & (confidence < settings.farther_confidence)
    value[farther] = raw[farther]
    source[farther] = RepairSource.RAW
    source[~np.isfinite(value)] = RepairSource.NONE
    return value, source


def _across_gaps(
    azimuth_rad: FloatArray,
    range_m: FloatArray,
    support: BoolArray,
    edge_m: float,
) -> tuple[FloatArray, FloatArray]:
    """(B,) range on the straight line between the ends of the gap around each beam, and the gap's
    width. An end is the mean point of up to three supporting beams of one surface. NaN where an
    end is missing, the ends lie on different surfaces, or a return within the gap is nearer: it
    may be all that is seen of a dark table leg."""
    count = range_m.size
    index = np.arange(count)
    good = np.flatnonzero(support)
    filled = np.full(count, np.nan)
    width = np.full(count, np.inf)
    if good.size < 2:
        return filled, width
    order = np.searchsorted(good, index)
    inner = (order > 0) & (order < good.size) & ~support
    left, right = order[inner] - 1, order[inner]
    points = range_m[good, np.newaxis] * np.stack(
        [np.cos(azimuth_rad[good]), np.sin(azimuth_rad[good])], axis=1
    )
    left_end = _end_points(points, range_m[good], left, -1, edge_m)
    right_end = _end_points(points, range_m[good], right, 1, edge_m)
    chord = right_end - left_end
    direction = np.stack([np.cos(azimuth_rad[inner]), np.sin(azimuth_rad[inner])], axis=1)
    turn = direction[:, 0] * chord[:, 1] - direction[:, 1] * chord[:, 0]
    reach = left_end[:, 0] * chord[:, 1] - left_end[:, 1] * chord[:, 0]
    crossing = np.full(turn.size, np.nan)
    np.divide(reach, turn, out=crossing, where=np.abs(turn) > 1e-6)
    gap = np.abs(azimuth_rad[good[right]] - azimuth_rad[good[left]])
    step = np.abs(range_m[good[right]] - range_m[good[left]])
    # A slanted wall changes its range across a wide gap; an edge jumps.
    one_surface = step <= edge_m + gap * np.minimum(range_m[good[right]], range_m[good[left]])
    low = np.minimum(range_m[good[right]], range_m[good[left]]) - edge_m
    high = np.maximum(range_m[good[right]], range_m[good[left]]) + edge_m
    lost = np.where(np.isfinite(range_m[inner]), range_m[inner], np.inf)
    nearest = np.full(good.size + 1, np.inf)
    np.minimum.at(nearest, order[inner], lost)
    hides = nearest[order[inner]] < crossing - edge_m
    usable = one_surface & (crossing > low) & (crossing < high) & ~hides
    filled[inner] = np.where(usable, crossing, np.nan)
    width[inner] = gap
    return filled, width


def _end_points(
    points: FloatArray, ranges: FloatArray, nearest: IntArray, step: int, edge_m: float
) -> FloatArray:
    """(N, 2) mean of the good beam ``nearest`` and up to two more away from the gap."""
    total = points[nearest].copy()
    count = np.ones(nearest.size)
    for away in (1, 2):
        other = nearest + step * away
        inside = (other >= 0) & (other < ranges.size)
        clipped = np.clip(other, 0, ranges.size - 1)
        same = inside & (np.abs(ranges[clipped] - ranges[nearest]) < 0.5 * edge_m)
        total += np.where(same[:, np.newaxis], points[clipped], 0.0)
        count += same
    return total / count[:, np.newaxis]


@njit(cache=True)
def _image_planes(
    depth: Float32Array,
    rows: IntArray,
    columns: IntArray,
    expected_m: FloatArray,
    reach: int,
    edge_m: float,
) -> FloatArray:
    """(N, 2) depth and its expected error, from the plane through the good pixels around a pixel.

    A plane's inverse depth is linear in the pixel, so three parameters are fitted to it over the
    smallest window that has enough pixels of one surface on both sides of the row or column.
    """
    height, width = depth.shape
    out = np.full((rows.size, 2), np.nan)
    for index in range(rows.size):
        row, column = rows[index], columns[index]
        if row < 0:
            continue
        size = 2
        while size <= reach:
            low_r, high_r = max(0, row - size), min(height, row + size + 1)
            low_c, high_c = max(0, column - size), min(width, column + size + 1)
            step = max(1, size // 6)
            values = np.empty(((high_r - low_r), (high_c - low_c))).ravel()
            du = np.empty(values.size)
            dv = np.empty(values.size)
            count = 0
            for r in range(low_r, high_r, step):
                for c in range(low_c, high_c, step):
                    if r == row and c == column:
                        continue
                    value = depth[r, c]
                    if np.isnan(value):
                        continue
                    values[count] = value
                    du[count] = c - column
                    dv[count] = r - row
                    count += 1
            if count >= 8:
                middle = expected_m[index]
                if np.isnan(middle):
                    middle = np.median(values[:count])
                result = _fit_inverse_plane(values[:count], du[:count], dv[:count], middle, edge_m)
                if not np.isnan(result[0]):
                    out[index, 0] = result[0]
                    out[index, 1] = result[1]
                    break
            size = size * 2 if size < 16 else size + 8
    return out


@njit(cache=True)
def _fit_inverse_plane(
    values: FloatArray, du: FloatArray, dv: FloatArray, middle: float, edge_m: float
) -> tuple[float, float]:
    """Depth at (0, 0) and its expected error; NaN where the pixels are one-sided or no plane."""
    normal = np.zeros((3, 3))
    target = np.zeros(3)
    count = 0
    left = right = up = down = 0
    for k in range(values.size):
        if abs(values[k] - middle) > edge_m:
            continue
        weight = values[k] ** 2
        a = np.array([1.0, du[k], dv[k]])
        for i in range(3):
            target[i] += weight * a[i] / values[k]
            for j in range(3):
                normal[i, j] += weight * a[i] * a[j]
        count += 1
        # Opposite sectors, not half planes: pixels on one side alone have some above and below.
        beside = abs(du[k]) >= abs(dv[k])
        left += beside and du[k] < 0
        right += beside and du[k] > 0
        up += not beside and dv[k] < 0
        down += not beside and dv[k] > 0
    both_sides = (left >= 2 and right >= 2) or (up >= 2 and down >= 2)
    if count < 8 or not both_sides or 2 * count < values.size:
        return np.nan, np.nan
    for i in range(3):
        normal[i, i] += 1e-9
    solution = np.linalg.solve(normal, target)
    if solution[0] <= 0.0 or abs(1.0 / solution[0] - middle) > edge_m:
        return np.nan, np.nan
    square = 0.0
    for k in range(values.size):
        if abs(values[k] - middle) > edge_m:
            continue
        inverse = solution[0] + solution[1] * du[k] + solution[2] * dv[k]
        square += (values[k] * (1.0 - values[k] * inverse)) ** 2
    rms = np.sqrt(square / count)
    covariance = np.linalg.inv(normal)
    spread = rms * np.sqrt(covariance[0, 0]) / solution[0]
    # What the plane leaves unexplained is structure as much as noise.
    return 1.0 / solution[0], spread + 0.3 * rms
