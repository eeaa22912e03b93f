"""How well holes and burrs were repaired, against the truth and against plain interpolation.

*LiDAR*: beams inside the camera's view (the rows of samples.parquet) with a true range within
``range_max_m`` that are holes or burrs in truth. The baseline is linear interpolation over the
scan's own raw valid beams; it has no labels, so a burr is valid to it. The folder has raw ranges
only inside the view; outside of it the baseline reads the true ranges of the good beams, which can
only improve it.

*Depth*: paired pixels that are holes or burrs in truth, along the optical axis. The baselines are
``cv2.inpaint`` (Telea) and the nearest valid pixel, on the raw image that the caller passes.

Errors are taken over the samples that were repaired, a sample once for each frame that shows it,
separately for gaps (runs of samples that are not good in truth) of 3 degrees and more, and for
narrower ones. The baselines' errors are over the same samples.

What is filled more than 0.3 m behind the true surface is free space that is not there: its fraction
is given for each source (``behind_surface``), beside the fraction of the holes that were filled.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.evaluation.associated_truth import AssociatedTruth, TrueCamera, associate_truth
from fusion_core.evaluation.depth_baselines import BASELINES, fill_by_baselines
from fusion_core.evaluation.fuse_folder import (
    FuseFolder,
    Samples,
    open_fuse_folder,
    read_samples,
)
from fusion_core.evaluation.repair_errors import (
    ComparedSamples,
    RepairErrors,
    pool_errors,
    repair_errors,
    was_repaired,
)
from fusion_core.evaluation.runs import run_bounds
from fusion_core.evaluation.truth import Truth
from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import BoolArray, Float32Array, FloatArray, IntArray
from fusion_core.model.errors import ScanLoomError

# By definition of the measure: three samples at the paper's sampling of one per degree.
WIDE_GAP_DEG = 3.0

DepthImages = Iterable[tuple[str, int, Float32Array]]
"""(camera topic, stamp_ns, (H, W) raw depth in metres with NaN for missing) of each image."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairReport:
    """The repairs of both sensors."""

    lidar: RepairErrors
    depth: RepairErrors

    def to_json(self) -> dict[str, Any]:
        """Both sensors as plain dictionaries."""
        return {"lidar": self.lidar.to_json(), "depth": self.depth.to_json()}


def evaluate_repair(
    fuse_dir: Path, truth: Truth, depth_images: DepthImages | None = None
) -> RepairReport:
    """Compare the repaired values in ``fuse_dir`` with ``truth``.

    ``depth_images`` are the recording's raw images, in any order; without them the depth repairs
    have no baselines.

    Raises ScanLoomError where a file is invalid, folder and truth are of different recordings, or
    the raw image of a repaired pixel is missing.
    """
    folder = open_fuse_folder(fuse_dir)
    associated = associate_truth(truth, folder)
    linear_m = _linear_interpolation_m(folder, associated)
    lidar, depth, pixels = [], [], []
    for samples in read_samples(folder):
        lidar.append(_lidar_errors(samples, folder, associated, linear_m))
        depth_errors, repaired_pixels = _depth_errors(samples, associated)
        depth.append(depth_errors)
        pixels.append(repaired_pixels)
    report = RepairReport(lidar=pool_errors(lidar, ("linear",)), depth=pool_errors(depth, ()))
    if depth_images is None or not pixels:
        return report
    baselines = _depth_baseline_errors(_concatenate_pixels(pixels), associated, depth_images)
    return replace(report, depth=replace(report.depth, baseline_error_m=baselines))


def pool_repair(reports: Sequence[RepairReport]) -> RepairReport:
    """One report over the repaired samples of several recordings.

    A baseline that is missing in one of them is missing in the pool.
    """
    baselines = [set(report.depth.baseline_error_m) for report in reports]
    common = [name for name in BASELINES if all(name in own for own in baselines)]
    return RepairReport(
        lidar=pool_errors([report.lidar for report in reports], ("linear",)),
        depth=pool_errors([report.depth for report in reports], common),
    )


def _linear_interpolation_m(folder: FuseFolder, associated: AssociatedTruth) -> FloatArray:
    """(S, N) range that linear interpolation gives at each beam of each scan, NaN in scans without
    any valid beam."""
    truth = associated.truth
    raw_m = np.where(truth.kind == NoiseClass.GOOD, truth.range_m, np.nan)
    for samples in read_samples(folder):
        raw_m[associated.scan_index(samples.scan_stamp_ns), samples.lidar_beam] = (
            samples.lidar_raw_m
        )
    order = np.argsort(associated.beam_angle_rad)
    angle_rad = associated.beam_angle_rad[order]
    filled_m = np.full(raw_m.shape, np.nan)
    for filled, raw in zip(filled_m, raw_m, strict=True):
        valid = np.isfinite(raw[order])
        if valid.any():
            filled[order] = np.interp(angle_rad, angle_rad[valid], raw[order][valid])
    return filled_m


def _lidar_errors(
    samples: Samples, folder: FuseFolder, associated: AssociatedTruth, linear_m: FloatArray
) -> RepairErrors:
    truth = associated.truth
    scan, beam = associated.scan_index(samples.scan_stamp_ns), samples.lidar_beam
    kind = truth.kind[scan, beam]
    true_m = truth.range_m[scan, beam]
    scans, which = np.unique(scan, return_inverse=True)
    first, last = run_bounds(truth.kind[scans] != NoiseClass.GOOD)
    beam_step_deg = np.degrees(abs(associated.beam_angle_rad[1] - associated.beam_angle_rad[0]))
    gap_deg = (last - first + 1)[which, beam] * beam_step_deg
    wanted = (kind != NoiseClass.GOOD) & (true_m <= folder.lidar.range_max_m)
    good = kind == NoiseClass.GOOD
    compared = ComparedSamples(
        wanted=wanted,
        hole=wanted & (kind == NoiseClass.HOLE),
        repaired=wanted & was_repaired(samples.lidar_source, samples.lidar_repaired_m),
        wide=_is_wide(gap_deg),
        source=samples.lidar_source,
        true_m=true_m,
        repaired_m=samples.lidar_repaired_m,
        returns=good & np.isfinite(samples.lidar_raw_m),
        raw_m=samples.lidar_raw_m,
    )
    return repair_errors(compared, {"linear": linear_m[scan, beam]})


@dataclass(frozen=True, slots=True, kw_only=True)
class _RepairedPixels:
    """Repaired depth pixels: camera, index of the image in the truth, row and column."""

    camera: IntArray
    image: IntArray
    row: IntArray
    column: IntArray
    true_m: FloatArray


def _concatenate_pixels(parts: Sequence[_RepairedPixels]) -> _RepairedPixels:
    """All parts, of which there is at least one, in their order."""
    return _RepairedPixels(
        camera=np.concatenate([part.camera for part in parts]),
        image=np.concatenate([part.image for part in parts]),
        row=np.concatenate([part.row for part in parts]),
        column=np.concatenate([part.column for part in parts]),
        true_m=np.concatenate([part.true_m for part in parts]),
    )


def _depth_errors(
    samples: Samples, associated: AssociatedTruth
) -> tuple[RepairErrors, _RepairedPixels]:
    paired = samples.paired
    camera = samples.camera[paired]
    row, column = samples.depth_row[paired], samples.depth_column[paired]
    image = associated.image_index(camera, samples.stamp_ns[paired])
    kind = np.zeros(paired.shape, dtype=np.int64)
    true_m = np.full(paired.shape, np.nan)
    gap_deg = np.zeros(paired.shape)
    for code, own in enumerate(associated.cameras):
        mine = camera == code
        pixel = image[mine], row[mine], column[mine]
        kind[mine] = own.truth.kind[pixel]
        true_m[mine] = own.truth.depth_m(*pixel)
        gap_deg[mine] = _depth_gap_deg(own, *pixel)
    wanted = (kind != NoiseClass.GOOD) & np.isfinite(true_m)
    source, repaired_m = samples.depth_source[paired], samples.depth_repaired_m[paired]
    raw_m = samples.depth_raw_m[paired]
    repaired = wanted & was_repaired(source, repaired_m)
    compared = ComparedSamples(
        wanted=wanted,
        hole=wanted & (kind == NoiseClass.HOLE),
        repaired=repaired,
        wide=_is_wide(gap_deg),
        source=source,
        true_m=true_m,
        repaired_m=repaired_m,
        returns=(kind == NoiseClass.GOOD) & np.isfinite(raw_m),
        raw_m=raw_m,
    )
    pixels = _RepairedPixels(
        camera=camera[repaired],
        image=image[repaired],
        row=row[repaired],
        column=column[repaired],
        true_m=true_m[repaired],
    )
    return repair_errors(compared, {}), pixels


def _is_wide(gap_deg: FloatArray) -> BoolArray:
    # Three beams of one degree are three degrees, whatever the last digit of their product.
    wide: BoolArray = np.round(gap_deg, 6) >= WIDE_GAP_DEG
    return wide


def _depth_gap_deg(
    camera: TrueCamera, image: IntArray, row: IntArray, column: IntArray
) -> FloatArray:
    """Width of the run of pixels that are not good, along the image's level axis."""
    fx, fy, cx, cy = camera.intrinsics
    along_rows = camera.rows_are_level
    focal_px, centre_px = (fx, cx) if along_rows else (fy, cy)
    position = column if along_rows else row
    gap_deg = np.zeros(image.shape)
    for shown in np.unique(image):
        mine = np.flatnonzero(image == shown)
        not_good = camera.truth.kind[shown] != NoiseClass.GOOD
        lines = not_good[row[mine]] if along_rows else not_good.T[column[mine]]
        first, last = (bound[np.arange(mine.size), position[mine]] for bound in run_bounds(lines))
        left_rad = np.arctan((first - 0.5 - centre_px) / focal_px)
        right_rad = np.arctan((last + 0.5 - centre_px) / focal_px)
        gap_deg[mine] = np.degrees(right_rad - left_rad)
    return gap_deg


def _depth_baseline_errors(
    pixels: _RepairedPixels, associated: AssociatedTruth, depth_images: DepthImages
) -> dict[str, FloatArray]:
    """Errors of the baselines at the repaired pixels, one image in memory at a time."""
    errors = {name: np.full(pixels.image.shape, np.nan) for name in BASELINES}
    missing = np.ones(pixels.image.shape, dtype=np.bool_)
    codes = {camera.topic: code for code, camera in enumerate(associated.cameras)}
    for topic, stamp_ns, depth_m in depth_images:
        if topic not in codes:
            continue
        stamps = associated.cameras[codes[topic]].truth.stamp_ns[pixels.image]
        mine = np.flatnonzero((pixels.camera == codes[topic]) & (stamps == stamp_ns))
        if mine.size == 0:
            continue
        missing[mine] = False
        filled = fill_by_baselines(depth_m, pixels.row[mine], pixels.column[mine])
        for name, value_m in filled.items():
            errors[name][mine] = np.abs(value_m - pixels.true_m[mine])
    if missing.any():
        first = int(np.flatnonzero(missing)[0])
        camera = associated.cameras[pixels.camera[first]]
        raise ScanLoomError(
            f"no raw image of {camera.topic} with stamp "
            f"{camera.truth.stamp_ns[pixels.image[first]]} ns was given.",
            file=associated.truth.file,
            advice="Give the recording that was fused.",
        )
    return errors
