"""The pose of a LiDAR in a camera's frame from what both see, without a target (Song 2022 §2.2).

1. The cloud as intensity images of virtual cameras (``intensity_image.py``), in the directions that
   the cloud fills, until one shows what the camera sees.
2. SIFT features of the two images matched (``feature_matches.py``): a first pose.
3. Beyond the paper: the cloud rendered from that pose, and small patches matched to a fraction of a
   pixel (``patch_matches.py``), twice.
4. Reprojection filtering and refinement (``reprojection.py``), judged on pairs that were held out.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fusion_core.calibration.features import (
    cloud_filter,
    feature_matches,
    intensity_image,
    reprojection,
)
from fusion_core.calibration.features.cloud_filter import CloudFilterSettings, usable_points
from fusion_core.calibration.features.dlt import require_determined
from fusion_core.calibration.features.feature_matches import (
    FeatureSettings,
    camera_features,
    match_features,
)
from fusion_core.calibration.features.guess_check import keep_better
from fusion_core.calibration.features.intensity_image import (
    IntensityImage,
    IntensityImageSettings,
    PixelSizeSearch,
    render_intensity_image,
    search_pixel_size,
)
from fusion_core.calibration.features.matched_pairs import MatchedPairs
from fusion_core.calibration.features.patch_matches import PatchSettings, camera_view, match_patches
from fusion_core.calibration.features.pose_fit import reprojection_residuals
from fusion_core.calibration.features.reprojection import (
    FilteredPose,
    ReprojectionCurve,
    ReprojectionSettings,
    covariance_of,
    estimate_pose,
    held_out_residuals,
    image_blocks,
    reprojection_curve,
)
from fusion_core.calibration.features.virtual_camera import (
    VirtualCamera,
    camera_towards,
    cloud_directions,
)
from fusion_core.calibration.reprojection_rms import reprojection_rms
from fusion_core.model.conventions import ByteArray, FloatArray
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.extrinsics import ExtrinsicsEstimate
from fusion_core.model.progress import Progress, silent
from fusion_core.model.sensors import CameraIntrinsics, PointCloud
from fusion_core.settings import SettingsGroup, StageSettings, setting

_NEEDS = (
    "Both sensors must see a scene with texture at different distances, and the cloud must be "
    "dense, as of a LiDAR that turns. For a sparse cloud give an initial guess with --guess."
)
# A virtual picture is this much wider than the camera's, which then fits into one of two.
_VIEW_MARGIN = 1.5
_HALF_VIEW_MAX_RAD = np.deg2rad(55.0)


class PoseSearchSettings(StageSettings):
    """How a first pose is searched, and refined."""

    refine_by: Literal["patches", "none"] = setting(
        "patches", "After the features, match patches of the cloud as rendered from the first pose"
    )
    reduce_camera: bool = setting(
        True, "Features of the camera's image are found in pixels of the same size"
    )
    enough_pairs: int = setting(
        40, "Pairs of a view at which no other view is tried", ge=6, le=100_000
    )
    view_points_max: int = setting(
        3_000_000, "Most points of the views in which features are searched", ge=10_000, le=10**8
    )
    guess_radius_px: float = setting(
        150.0,
        "With an initial guess: features are compared within this distance of where it projects "
        "them",
        unit="px",
        ge=5.0,
        le=10_000.0,
    )
    first_patch_search_px: float = setting(
        16.0, "First round: patches are searched so far around", unit="px", ge=1.0, le=200.0
    )
    first_patch_scale: float = setting(
        1.5, "First round: pixel size, of the second round's", ge=1.0, le=8.0
    )
    patch_search_px: float = setting(
        8.0, "Second round: patches are searched so far around", unit="px", ge=1.0, le=200.0
    )


class FeatureCalibrationSettings(SettingsGroup):
    """Every stage's settings."""

    cloud: CloudFilterSettings = CloudFilterSettings()
    image: IntensityImageSettings = IntensityImageSettings()
    features: FeatureSettings = FeatureSettings()
    search: PoseSearchSettings = PoseSearchSettings()
    patches: PatchSettings = PatchSettings()
    pose: ReprojectionSettings = ReprojectionSettings()


PUBLISHED = FeatureCalibrationSettings(
    cloud=cloud_filter.PUBLISHED,
    image=intensity_image.PUBLISHED,
    features=feature_matches.PUBLISHED,
    search=PoseSearchSettings(
        refine_by="none", reduce_camera=False, enough_pairs=30, view_points_max=10**8
    ),
    pose=reprojection.PUBLISHED,
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraCalibration:
    """An estimate with its evidence.

    ``features``: the SIFT pairs, of ``feature_image``. ``pairs``: those that the pose is estimated
    from, of ``image``; both are the features' where no patches were matched. ``curve``: Fig. 11.
    ``held_out_px``: (n, 2) residuals (18) of the n pairs that matching accepted, by estimates
    without them, NaN where there is none.
    """

    estimate: ExtrinsicsEstimate
    intrinsics: CameraIntrinsics
    feature_image: IntensityImage
    features: MatchedPairs
    image: IntensityImage
    pairs: MatchedPairs
    curve: ReprojectionCurve
    held_out_px: FloatArray
    pixel_sizes: PixelSizeSearch


def calibrate_by_features(
    cloud: PointCloud,
    grey: ByteArray,
    intrinsics: CameraIntrinsics,
    settings: FeatureCalibrationSettings,
    *,
    T_guess: FloatArray | None = None,
    near_guess: bool = False,
    progress: Progress = silent,
) -> CameraCalibration:
    """T_camera_lidar of a cloud with intensities and the (H, W) grey image of a camera.

    ``T_guess``: (4, 4) an initial guess; features are then searched around its prediction first,
    and nowhere else if ``near_guess``; it is kept where the result is no better on pairs that were
    held out. Raises CalibrationFailed for input that cannot be used, and where too few pairs agree.
    """
    require_image_size(grey, intrinsics)
    progress(0, None, "filter the cloud")
    points_m, intensity = usable_points(cloud, settings.cloud)
    found = _search_features(
        points_m, intensity, grey, intrinsics, settings, T_guess, near_guess, progress
    )
    image, pairs, T = found.image, found.pairs, found.T_camera_lidar
    pixel_sizes = found.pixel_sizes
    if settings.search.refine_by == "patches":
        progress(0, None, "match patches")
        pixel_sizes = search_pixel_size(points_m, camera_view(T, intrinsics, 1.0), settings.image)
        chosen = pixel_sizes.chosen
        for size, search_px in (
            (chosen * settings.search.first_patch_scale, settings.search.first_patch_search_px),
            (chosen, settings.search.patch_search_px),
        ):
            pairs, image = match_patches(
                points_m,
                intensity,
                grey,
                intrinsics,
                T,
                pixel_size=size,
                search_px=search_px,
                image_settings=settings.image,
                cloud_settings=settings.cloud,
                settings=settings.patches,
            )
            T = _estimate(pairs, intrinsics, T, settings.pose)
    progress(0, None, "estimate the pose")
    return _with_evidence(found, image, pairs, pixel_sizes, intrinsics, T, settings, T_guess)


def require_image_size(grey: ByteArray, intrinsics: CameraIntrinsics) -> None:
    """Raise CalibrationFailed for an image of another size than the intrinsics state."""
    height, width = grey.shape
    if (width, height) != (intrinsics.width, intrinsics.height):
        raise CalibrationFailed(
            f"the image has {width} x {height} pixels, the intrinsics are of "
            f"{intrinsics.width} x {intrinsics.height}.",
            advice="Give the image as the camera was calibrated with, or intrinsics of this size.",
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _FirstPose:
    T_camera_lidar: FloatArray
    image: IntensityImage
    pairs: MatchedPairs
    pixel_sizes: PixelSizeSearch


def _search_features(
    points_m: FloatArray,
    intensity: FloatArray,
    grey: ByteArray,
    intrinsics: CameraIntrinsics,
    settings: FeatureCalibrationSettings,
    T_guess: FloatArray | None,
    near_guess: bool,
    progress: Progress,
) -> _FirstPose:
    """The view with the most pairs that agree, and the pose of these."""
    step = -(-len(points_m) // settings.search.view_points_max)
    some_m, some_intensity = points_m[::step], intensity[::step]
    focal_px = 0.5 * (intrinsics.fx + intrinsics.fy)
    half_rad = np.arctan(0.5 * max(intrinsics.width, intrinsics.height) / focal_px)
    half_rad = min(half_rad, _HALF_VIEW_MAX_RAD)
    width, height = (
        round(min(_VIEW_MARGIN * size, 2.0 * focal_px * np.tan(_HALF_VIEW_MAX_RAD) * 1.2))
        for size in (intrinsics.width, intrinsics.height)
    )
    directions = [] if near_guess else cloud_directions(some_m, 2.0 * half_rad)
    views = [
        camera_towards(direction, focal_px=focal_px, width=width, height=height)
        for direction in directions
    ]
    predictions: list[tuple[FloatArray, float] | None] = [None] * len(views)
    if T_guess is not None:
        views.insert(0, camera_view(T_guess, intrinsics, 1.0))
        predictions.insert(0, (T_guess, settings.search.guess_radius_px))
    if not views:
        raise CalibrationFailed("the cloud fills no field of view.", advice=_NEEDS)
    progress(0, len(views), "match features")
    sizes = search_pixel_size(some_m, views[0], settings.image)
    size = sizes.chosen
    clahe = settings.image.clahe_limit if settings.image.equalisation == "clahe" else 0.0
    reduced = size if settings.search.reduce_camera else 1.0
    camera = camera_features(grey, reduced, clahe, settings.features)
    if len(camera.pixels) < settings.pose.pairs_min:
        raise CalibrationFailed(
            f"the camera's image has only {len(camera.pixels)} features; at least "
            f"{settings.pose.pairs_min} are needed.",
            advice=_NEEDS,
        )

    def render(view: VirtualCamera) -> IntensityImage:
        return render_intensity_image(
            some_m,
            some_intensity,
            view.with_pixel_size(size),
            size,
            settings.image,
            settings.cloud,
        )

    best = None
    for number, (image, predicted) in enumerate(
        zip(_made_ahead(render, views), predictions, strict=True)
    ):
        progress(number, len(views), "match features")
        pairs = match_features(image, camera, intrinsics, settings.features, predicted=predicted)
        count = pairs.distinct
        if best is None or count > best[0]:
            best = count, image, pairs
        if count >= settings.search.enough_pairs:
            break
    progress(len(views), len(views), "match features")
    assert best is not None, "there is a view"
    count, image, pairs = best
    if count < settings.pose.pairs_min:
        raise CalibrationFailed(
            f"only {count} features of the intensity image agree with the camera's image on one "
            f"pose; at least {settings.pose.pairs_min} are needed.",
            advice=_NEEDS,
        )
    T = _estimate(pairs, intrinsics, None, settings.pose)
    return _FirstPose(T_camera_lidar=T, image=image, pairs=pairs, pixel_sizes=sizes)


def _made_ahead(
    render: Callable[[VirtualCamera], IntensityImage], views: Sequence[VirtualCamera]
) -> Iterator[IntensityImage]:
    """The views' images in their order. While one is matched, another thread makes the next; not
    while the first is, which is often enough."""
    yield render(views[0])
    if len(views) == 1:
        return
    with ThreadPoolExecutor(1) as other:
        coming = other.submit(render, views[1])
        for view in views[2:]:
            image = coming.result()
            coming = other.submit(render, view)
            yield image
        yield coming.result()


def _projection_note(
    filtered: FilteredPose, points_m: FloatArray, pixels: FloatArray, intrinsics: CameraIntrinsics
) -> tuple[str, ...]:
    fit = filtered.fit
    if np.array_equal(fit.T_projection, fit.T_camera_lidar):
        return ()
    used = filtered.used
    rms_px = reprojection_rms(
        reprojection_residuals(fit.T_camera_lidar, points_m[used], pixels[used], intrinsics)
    )
    return (
        "The reprojection errors are those of the projection matrix M (8), which fits more than a "
        f"pose can; by its R and T the used pairs are reprojected to {rms_px:.1f} px.",
    )


def _estimate(
    pairs: MatchedPairs,
    intrinsics: CameraIntrinsics,
    T_start: FloatArray | None,
    settings: ReprojectionSettings,
) -> FloatArray:
    kept = pairs.accepted
    filtered = estimate_pose(
        pairs.points_m[kept], pairs.image_px[kept], intrinsics, T_start, settings
    )
    return filtered.fit.T_camera_lidar


def _with_evidence(
    found: _FirstPose,
    image: IntensityImage,
    pairs: MatchedPairs,
    pixel_sizes: PixelSizeSearch,
    intrinsics: CameraIntrinsics,
    T_start: FloatArray,
    settings: FeatureCalibrationSettings,
    T_guess: FloatArray | None,
) -> CameraCalibration:
    matched = np.flatnonzero(pairs.accepted)
    points_m, pixels = pairs.points_m[matched], pairs.image_px[matched]
    filtered = estimate_pose(points_m, pixels, intrinsics, T_start, settings.pose)
    T = filtered.fit.T_camera_lidar
    require_determined(points_m[filtered.used])
    held_out = held_out_residuals(points_m, pixels, intrinsics, T, settings.pose)
    judged = np.isfinite(held_out).all(axis=1)
    if np.count_nonzero(judged & filtered.used) < settings.pose.pairs_min:
        raise CalibrationFailed(
            f"the {len(matched)} pairs lie too close together in the image to be judged by each "
            "other.",
            advice=_NEEDS,
        )
    rms_px = reprojection_rms(held_out[judged])
    if rms_px > settings.pose.rms_max_px:
        raise CalibrationFailed(
            f"no pose explains the {len(matched)} pairs: those that were held out are reprojected "
            f"to {rms_px:.1f} px.",
            advice=_NEEDS,
        )
    blocks = image_blocks(pixels, intrinsics)
    covariance, about_it = covariance_of(
        filtered, points_m, pixels, held_out, intrinsics, settings.pose
    )
    curve = reprojection_curve(points_m, pixels, intrinsics, T, filtered.used, settings.pose)
    kind = "pairs"
    if pairs is not found.pairs:
        kind = f"pairs of patches, predicted by {found.pairs.distinct} matches of features,"
    estimate = ExtrinsicsEstimate(
        T_camera_lidar=T,
        covariance=covariance,
        method="features" if settings.search.refine_by == "none" else "features and patches",
        verdict=(
            f"{np.count_nonzero(filtered.used)} {kind} over {np.unique(blocks).size} parts of the "
            f"image agree on one pose; pairs that were held out are reprojected to "
            f"{rms_px:.2f} px."
        ),
        improved=True,
        T_guess=None,
        reprojection_rms_px=rms_px,
        reprojection_rms_used_px=reprojection_rms(filtered.fit.residuals_px),
        notes=(
            about_it,
            "The intrinsics are taken as exact: their errors are not in the covariance.",
            *_projection_note(filtered, points_m, pixels, intrinsics),
        ),
    )
    if T_guess is not None:
        estimate = keep_better(estimate, T_guess, points_m, pixels, held_out, intrinsics)
    return CameraCalibration(
        estimate=estimate,
        intrinsics=intrinsics,
        feature_image=found.image,
        features=found.pairs,
        image=image,
        pairs=pairs.rejected(matched[~filtered.used], "reprojection"),
        curve=curve,
        held_out_px=held_out,
        pixel_sizes=pixel_sizes,
    )
