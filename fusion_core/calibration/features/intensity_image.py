"""A grey image of a cloud's intensities, as a virtual camera sees it (Song 2022 §2.2.1).

Each pixel keeps the 3D point that it shows. Where several points fall into one pixel, those at the
median distance are shown (the paper's occlusion).
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from fusion_core.calibration.features.cloud_filter import CloudFilterSettings, is_no_outlier
from fusion_core.calibration.features.intensity_correction import corrected_intensity
from fusion_core.calibration.features.virtual_camera import VirtualCamera
from fusion_core.compiled import compiled
from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray, IntArray, read_only
from fusion_core.settings import StageSettings, setting

# A hole in the picture is filled from pixels with at least this much weight around it.
_LEAST_WEIGHT = 1e-3
_CLAHE_TILES = (8, 8)
_OUTLINE_PX = 25
# At 2 m, 12 cm.
_NORMAL_WINDOW_RAD = 0.06


class IntensityImageSettings(StageSettings):
    """Settings of ``render_intensity_image`` and of the search of the pixel size."""

    pixel_size: float = setting(
        0.0,
        "Width of a virtual pixel; 0: searched, the smallest that leaves few of them empty",
        unit="camera pixels",
        ge=0.0,
        le=32.0,
    )
    filled_fraction_min: float = setting(
        0.5, "Least fraction of pixels with a point, for a pixel size to be taken", ge=0.05, le=1.0
    )
    pixel_value: Literal["mean", "median"] = setting(
        "mean",
        "A pixel shows the mean of its points at the median distance, or the median point alone",
    )
    occlusion_fraction: float = setting(
        0.05,
        "Points nearer or farther than a pixel's median distance by more are not shown",
        unit="of the distance",
        ge=1e-3,
        le=1.0,
    )
    correction: Literal["fitted", "none"] = setting(
        "fitted", "Undo how the intensity falls with range and incidence angle, as the cloud shows"
    )
    equalisation: Literal["clahe", "rank", "none"] = setting(
        "clahe", "Contrast of the picture that features are found in"
    )
    clahe_limit: float = setting(4.0, "Contrast limit of CLAHE", ge=1.0, le=40.0)
    fill_radius_px: float = setting(
        0.7,
        "Smoothing of the picture, which also closes holes of about twice this radius; 0: none",
        unit="virtual pixels",
        ge=0.0,
        le=10.0,
    )


PUBLISHED = IntensityImageSettings(
    filled_fraction_min=0.9,
    pixel_value="median",
    correction="none",
    equalisation="none",
    fill_radius_px=0.0,
)
"""The virtual focal length is the real one, in camera pixels, and the pixel size such that few
pixels are empty (Fig. 9): our reading of the paper's 0.5 mm, which it chose by eye."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IntensityImage:
    """What a virtual camera sees of a cloud.

    ``picture``: (H, W) uint8, equalised, small holes filled: for features and for people.
    ``smooth``: (H, W) float32 the same before it was equalised, NaN in larger holes.
    ``intensity``: (H, W) float32 corrected intensity, NaN where no point falls. ``points_m``:
    (H, W, 3) float32 the point of each pixel in the LiDAR's frame, NaN where there is none; holes
    of the picture that are filled have none either. ``pixel_size``: camera pixels.
    ``filled_fraction``: pixels with a point, of those within the cloud's outline.
    ``kept_fraction``: points that are shown as a pixel's own, of those in the picture.
    """

    view: VirtualCamera
    picture: ByteArray
    smooth: Float32Array
    intensity: Float32Array
    points_m: Float32Array
    pixel_size: float
    filled_fraction: float
    kept_fraction: float

    def __post_init__(self) -> None:
        for array in (self.picture, self.smooth, self.intensity, self.points_m):
            read_only(array)


def render_intensity_image(
    points_m: FloatArray,
    intensity: FloatArray,
    view: VirtualCamera,
    pixel_size: float,
    settings: IntensityImageSettings,
    cloud_settings: CloudFilterSettings,
) -> IntensityImage:
    """Project (N, 3) points with (N,) intensities, all finite, into the virtual camera ``view``,
    without outliers.

    (11), (12), 0-based and with rows counted downwards: c = round((u' - u'_min) / dx),
    r = round((v' - v'_min) / dx). ``pixel_size`` is only recorded: it is the view's own.
    """
    kept, pixels, depth_m = view.see(points_m)
    passes = is_no_outlier(points_m[kept], cloud_settings)
    kept, pixels, depth_m = kept[passes], pixels[passes], depth_m[passes]
    cells = _cells_of(pixels, view)
    chosen, near = _median_points(cells, depth_m, settings.occlusion_fraction)
    shape = (view.height, view.width)
    points = np.full((view.height * view.width, 3), np.nan, dtype=np.float32)
    points[cells[chosen]] = points_m[kept[chosen]]
    values = np.full(view.height * view.width, np.nan, dtype=np.float64)
    if settings.pixel_value == "median":
        values[cells[chosen]] = intensity[kept[chosen]]
        weights = np.isfinite(values).astype(np.float64)
    else:
        sums, weights = _spread(pixels[near], intensity[kept[near]], view)
        # Only pixels that a point falls into have a value; others are filled for the picture.
        shown = cells[chosen]
        values[shown] = sums[shown] / weights[shown]
    shown_intensity = values.reshape(shape)
    shown_points = points.reshape(*shape, 3)
    if settings.correction == "fitted":
        # Wide enough that noise of some centimetres does not tilt the surface.
        window_px = max(9, round(_NORMAL_WINDOW_RAD * view.focal_px))
        shown_intensity = corrected_intensity(shown_intensity, shown_points, window_px)
    smooth = _smoothed(shown_intensity, weights.reshape(shape), settings.fill_radius_px)
    return IntensityImage(
        view=view,
        picture=_equalised(smooth, settings),
        smooth=smooth.astype(np.float32),
        intensity=shown_intensity.astype(np.float32),
        points_m=shown_points,
        pixel_size=pixel_size,
        filled_fraction=_filled_fraction(_occupied(cells, view)),
        kept_fraction=chosen.size / max(1, kept.size),
    )


def _cells(pixels: FloatArray, view: VirtualCamera) -> tuple[IntArray, IntArray]:
    """Flat pixel indices of the points that fall into the picture, and which points those are."""
    # NaN, behind the camera, compares false.
    inside = (
        (pixels[:, 0] >= -0.5)
        & (pixels[:, 0] < view.width - 0.5)
        & (pixels[:, 1] >= -0.5)
        & (pixels[:, 1] < view.height - 0.5)
    )
    kept = np.flatnonzero(inside)
    return _cells_of(pixels[kept], view), kept


def _cells_of(pixels: FloatArray, view: VirtualCamera) -> IntArray:
    """Flat indices of pixels in the picture."""
    nearest = np.floor(pixels + 0.5).astype(np.int64)
    cells: IntArray = nearest[:, 1] * view.width + nearest[:, 0]
    return cells


def _median_points(
    cells: IntArray, depth_m: FloatArray, occlusion_fraction: float
) -> tuple[IntArray, IntArray]:
    """The point of median distance in each pixel, and the points about as far as it."""
    order = _in_cells(cells, np.argsort(depth_m, kind="stable"))
    sorted_cells = cells[order]
    starts = np.flatnonzero(np.diff(sorted_cells, prepend=-1))
    counts = np.diff(np.append(starts, sorted_cells.size))
    # The lower of two middle points: a point that was measured, not a mean of two surfaces.
    chosen = order[starts + (counts - 1) // 2]
    median_m = np.repeat(depth_m[chosen], counts)
    near = order[np.abs(depth_m[order] - median_m) <= occlusion_fraction * median_m]
    return chosen, near


@compiled(nogil=True)
def _in_cells(cells: IntArray, order: IntArray) -> IntArray:
    """An ``order`` of points, (K,), sorted further by their ``cells``, (K,) small numbers, of each
    of which the points are counted."""
    starts = np.zeros(cells.max() + 2 if cells.size else 1, dtype=np.int64)
    for cell in cells:
        starts[cell + 1] += 1
    starts = np.cumsum(starts)
    in_cells = np.empty_like(order)
    for point in order:
        in_cells[starts[cells[point]]] = point
        starts[cells[point]] += 1
    return in_cells


def _spread(
    pixels: FloatArray, values: FloatArray, view: VirtualCamera
) -> tuple[FloatArray, FloatArray]:
    """Bilinear shares of each point to the four pixels around it: sums of value and of weight."""
    size = view.width * view.height
    corner = np.floor(pixels).astype(np.int64)
    fraction = pixels - corner
    sums, weights = np.zeros(size), np.zeros(size)
    for right in (0, 1):
        for below in (0, 1):
            u, v = corner[:, 0] + right, corner[:, 1] + below
            share = np.abs(1 - right - fraction[:, 0]) * np.abs(1 - below - fraction[:, 1])
            inside = (u >= 0) & (u < view.width) & (v >= 0) & (v < view.height)
            flat = v[inside] * view.width + u[inside]
            sums += np.bincount(flat, share[inside] * values[inside], size)
            weights += np.bincount(flat, share[inside], size)
    return sums, np.maximum(weights, 1e-12)


def _smoothed(values: FloatArray, weights: FloatArray, radius_px: float) -> FloatArray:
    """Values with noise smoothed and small holes filled, NaN in larger ones."""
    if radius_px == 0.0:
        return values
    known = np.isfinite(values)
    weight = np.where(known, weights, 0.0)
    blurred = cv2.GaussianBlur(weight * np.where(known, values, 0.0), (0, 0), radius_px)
    weight = cv2.GaussianBlur(weight, (0, 0), radius_px)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(weight > _LEAST_WEIGHT, blurred / weight, np.nan)


def _equalised(values: FloatArray, settings: IntensityImageSettings) -> ByteArray:
    """uint8 with the contrast equalised; holes black."""
    known = np.isfinite(values)
    if not known.any():
        return np.zeros(values.shape, dtype=np.uint8)
    if settings.equalisation == "rank":
        order = np.sort(values[known])
        scaled = np.searchsorted(order, values) / order.size
    else:
        low, high = np.percentile(values[known], [1.0, 99.0])
        scaled = (values - low) / max(high - low, 1e-12)
    grey = np.where(known, np.clip(255.0 * scaled, 0.0, 255.0), 0.0).astype(np.uint8)
    return equalise(grey, settings.clahe_limit) if settings.equalisation == "clahe" else grey


def equalise(grey: ByteArray, clahe_limit: float) -> ByteArray:
    """(H, W) uint8 with its local contrast limited and equalised (CLAHE)."""
    return np.asarray(cv2.createCLAHE(clahe_limit, _CLAHE_TILES).apply(grey), dtype=np.uint8)


def _occupied(cells: IntArray, view: VirtualCamera) -> ByteArray:
    """(H, W) 1 where a point falls into the pixel."""
    occupied = np.zeros(view.height * view.width, dtype=np.uint8)
    occupied[cells] = 1
    return occupied.reshape(view.height, view.width)


def _filled_fraction(occupied: ByteArray) -> float:
    """Pixels with a point, of those within the outline of the cloud."""
    # A gap as wide as this is no hole between samples, it is the cloud's own edge.
    kernel = np.ones((_OUTLINE_PX, _OUTLINE_PX), dtype=np.uint8)
    outline = cv2.morphologyEx(occupied, cv2.MORPH_CLOSE, kernel)
    return float(occupied.sum() / max(1, int(outline.sum())))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelSizeSearch:
    """How the pixel size was chosen: (n,) sizes tried, in camera pixels, with the fraction of
    pixels that have a point, and of points that are kept, at each; ``chosen``."""

    sizes: FloatArray
    filled_fraction: FloatArray
    kept_fraction: FloatArray
    chosen: float


# Ratio of two sizes that are tried: the fourth root of two.
_SIZE_STEP = 2.0**0.25
_SIZE_MIN, _SIZE_MAX = 1.0, 16.0


def search_pixel_size(
    points_m: FloatArray, view: VirtualCamera, settings: IntensityImageSettings
) -> PixelSizeSearch:
    """The smallest pixel size with ``filled_fraction_min`` of the pixels filled (Fig. 9: a larger
    one loses points and blurs, a smaller one leaves pixels empty).

    Below one camera pixel there is nothing to match. A cloud that fills no size keeps the largest.
    """
    steps = int(np.floor(np.log(_SIZE_MAX / _SIZE_MIN) / np.log(_SIZE_STEP) + 1e-9))
    sizes: FloatArray = _SIZE_MIN * _SIZE_STEP ** np.arange(steps + 1, dtype=np.float64)
    pixels, _ = view.project(points_m)
    filled, kept = [], []
    for size in sizes:
        coarse = view.with_pixel_size(float(size))
        cells, points = _cells((pixels + 0.5) / size - 0.5, coarse)
        occupied = _occupied(cells, coarse)
        filled.append(_filled_fraction(occupied))
        kept.append(np.count_nonzero(occupied) / max(1, points.size))
        if filled[-1] >= settings.filled_fraction_min:
            break
    return PixelSizeSearch(
        sizes=sizes[: len(filled)],
        filled_fraction=np.array(filled),
        kept_fraction=np.array(kept),
        chosen=float(settings.pixel_size or sizes[len(filled) - 1]),
    )
