"""``scanloom calibrate camera``: the pose of a 3D LiDAR in a camera's frame, without a target
(Song 2022 §2.2)."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fusion_core.calibration.coloring import color_points
from fusion_core.calibration.features.camera_calibration import (
    CameraCalibration,
    calibrate_by_features,
)
from fusion_core.calibration.refinement.guess_refinement import refine_from_guess
from fusion_core.exporting.clouds import require_cloud_suffix, write_cloud
from fusion_core.exporting.extrinsics_files import extrinsics_document
from fusion_core.exporting.figures_camera_calibration import (
    write_matches,
    write_overlay,
    write_reprojection_curve,
)
from fusion_core.files.atomic import require_folder_of
from fusion_core.files.inputs import require_apart
from fusion_core.lens.projection import project_points
from fusion_core.model.conventions import ByteArray, FloatArray, IntArray
from fusion_core.model.errors import CalibrationFailed, ExportError
from fusion_core.model.extrinsics import ExtrinsicsEstimate
from fusion_core.model.geometry import transform_points
from fusion_core.model.names import printable
from fusion_core.model.progress import Progress
from fusion_core.model.sensors import PointCloud
from fusion_core.workflows.calibrate.camera_input import CameraInput, read_camera_input
from fusion_core.workflows.calibrate.camera_settings import CameraSettings, camera_settings
from fusion_core.workflows.calibrate.lidar import LidarOptions
from fusion_core.workflows.calibrate.result_files import require_result_apart, write_result

_OVERLAY_POINTS = 400_000
_FIGURES = ("matches", "patches", "reprojection", "overlay")


@dataclass(frozen=True, kw_only=True)
class CameraOptions(LidarOptions):
    """Those of ``calibrate lidar`` are for the recording of a turn; ``cloud`` is the coloured one.
    ``intrinsics_file``: None to take those of the recording."""

    intrinsics_file: Path | None = None
    guess_file: Path | None = None


def calibrate_camera(
    source: Path, image: Path, output: Path, options: CameraOptions, progress: Progress
) -> dict[str, Any]:
    """Calibrate the cloud, or the recorded turn, at ``source`` with ``image``, a file or the
    recording's topic of it; write ``output`` (.json or .toml), the files beside it and the figures.
    The result is ready for JSON.

    Raises ScanLoomError for what cannot be read, estimated or written.
    """
    preset, settings = camera_settings(options.preset, options.settings_file, options.seed)
    named = [source, image, options.intrinsics_file, options.guess_file, options.settings_file]
    inputs = [path for path in named if path is not None]
    require_result_apart(output, inputs)
    figures = {name: output.with_name(f"{output.stem}_{name}.png") for name in _FIGURES}
    for path in (*figures.values(), *([] if options.cloud is None else [options.cloud])):
        require_folder_of(path)
        require_apart(path, inputs)
    if options.cloud is not None:
        require_cloud_suffix(options.cloud)
    given = read_camera_input(
        source,
        image,
        intrinsics_file=options.intrinsics_file,
        guess_file=options.guess_file,
        points=options.points,
        joint=options.joint,
        settings=settings,
        progress=progress,
    )
    grey: ByteArray = np.asarray(cv2.cvtColor(given.rgb, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    try:
        estimate, calibration = _calibrate(given, grey, settings, progress)
    except CalibrationFailed as error:
        # Which of the two is at fault is said in words.
        raise CalibrationFailed(error.problem, file=source, advice=error.advice) from error
    progress(0, None, "write the results")
    heading = f"{printable(source.resolve().name)}, preset {preset}"
    more: dict[str, Any] = {"preset": preset}
    for path in figures.values():
        # Of an earlier result, which this one need not have.
        path.unlink(missing_ok=True)
    write_overlay(figures["overlay"], heading, grey=grey, panels=_overlay_panels(estimate, given))
    if calibration is not None:
        more.update(_evidence(calibration))
        _write_pair_figures(figures, heading, calibration, grey)
    if given.turn is not None:
        more["turn"] = given.turn
    if options.cloud is not None:
        more["colored_points"] = _write_colored(
            options.cloud, given, estimate.T_camera_lidar, settings
        )
    written = write_result(
        output,
        estimate,
        inputs=[*inputs, *given.files],
        camera_frame=given.camera_frame,
        lidar_frame=given.lidar_frame,
        intrinsics=given.intrinsics,
        more={**more, "input_notes": given.notes},
    )
    progress(1, 1, "write the results")
    drawn = [path for path in figures.values() if path.is_file()]
    beside = [*written[1:], *drawn, *([] if options.cloud is None else [options.cloud])]
    return {
        **extrinsics_document(estimate),
        **more,
        "file": str(output),
        "written": [str(path) for path in beside],
        "input_notes": given.notes,
    }


def _calibrate(
    given: CameraInput, grey: ByteArray, settings: CameraSettings, progress: Progress
) -> tuple[ExtrinsicsEstimate, CameraCalibration | None]:
    """The estimate by the settings' method, with the pairs where it is by features."""
    method, T_guess = settings.calibration.method, given.T_guess
    if method == "information" and T_guess is None:
        raise CalibrationFailed(
            "the method information needs an initial guess.",
            advice="Give it with --guess FILE, or set calibration.method to features.",
        )
    why_not = None
    if method != "information":
        try:
            calibration = calibrate_by_features(
                given.cloud,
                grey,
                given.intrinsics,
                settings,
                T_guess=T_guess,
                near_guess=T_guess is not None and method == "auto",
                progress=progress,
            )
            return calibration.estimate, calibration
        except CalibrationFailed as error:
            if method == "features" or T_guess is None:
                raise
            why_not = error.problem
    assert T_guess is not None, "the methods without a guess end above"
    cloud = given.cloud
    estimate = refine_from_guess(
        cloud.xyz_m.astype(np.float64),
        None if cloud.intensity is None else cloud.intensity.astype(np.float64),
        grey,
        given.intrinsics,
        T_guess,
        settings.guess,
        progress,
    ).estimate
    if why_not is not None:
        estimate = replace(estimate, notes=(*estimate.notes, f"Not by features: {why_not}"))
    return estimate, None


def camera_lines(result: dict[str, Any]) -> list[str]:
    """The result for people."""
    rotation_deg = [np.rad2deg(sd) for sd in list(result["sd"].values())[:3] if sd is not None]
    place_mm = [1e3 * sd for sd in list(result["sd"].values())[3:] if sd is not None]
    lines = [
        f"{'result':<11}{result['file']}",
        f"{'verdict':<11}{result['verdict']}",
    ]
    lines += [
        f"{'T' if row == 0 else '':<11}" + "  ".join(f"{value:10.6f}" for value in values)
        for row, values in enumerate(result["T_camera_lidar"][:3])
    ]
    if rotation_deg and place_mm:
        lines.append(
            f"{'deviations':<11}"
            f"rotation {', '.join(f'{value:.3f}' for value in rotation_deg)} deg, "
            f"position {', '.join(f'{value:.1f}' for value in place_mm)} mm"
        )
    held_out, used = result["reprojection_rms_px"], result["reprojection_rms_used_px"]
    if held_out is not None:
        lines.append(
            f"{'error (18)':<11}{held_out:.2f} px on pairs that were held out"
            + ("" if used is None else f", {used:.2f} px on those used")
        )
    lines += [f"{'note':<11}{note}" for note in (*result["notes"], *result["input_notes"])]
    return lines + [f"{'written':<11}{path}" for path in result["written"]]


def _evidence(calibration: CameraCalibration) -> dict[str, Any]:
    """What the result file says beside the estimate, ready for JSON."""
    reasons = sorted(set(calibration.pairs.reasons) - {""})
    counts = {reason: calibration.pairs.reasons.count(reason) for reason in reasons}
    return {
        "features_matched": int(calibration.features.accepted.sum()),
        "pairs_used": int(calibration.pairs.accepted.sum()),
        "pairs_rejected": counts,
        "pixel_size": {
            "chosen": calibration.pixel_sizes.chosen,
            "tried": calibration.pixel_sizes.sizes.tolist(),
            "filled_fraction": calibration.pixel_sizes.filled_fraction.tolist(),
            "kept_fraction": calibration.pixel_sizes.kept_fraction.tolist(),
        },
        "reprojection_curve": {
            "unfiltered": _curve_points(calibration.curve.pairs, calibration.curve.unfiltered_px),
            "filtered": _curve_points(calibration.curve.pairs, calibration.curve.filtered_px),
        },
    }


def _curve_points(pairs: IntArray, error_px: FloatArray) -> dict[str, list[float]]:
    """Fig. 11 as far as it is known."""
    known = np.isfinite(error_px)
    return {"pairs": pairs[known].tolist(), "error_px": error_px[known].tolist()}


def _write_pair_figures(
    figures: dict[str, Path], heading: str, calibration: CameraCalibration, grey: ByteArray
) -> None:
    features, pairs = calibration.features, calibration.pairs
    write_matches(
        figures["matches"],
        f"{heading}\nfeatures: {int(features.accepted.sum())} accepted of {len(features.reasons)}",
        grey=grey,
        picture=calibration.feature_image.picture,
        image_px=features.image_px,
        intensity_px=features.intensity_px,
        accepted=features.accepted,
    )
    if calibration.image is not calibration.feature_image:
        write_matches(
            figures["patches"],
            f"{heading}\npatches: {int(pairs.accepted.sum())} used of {len(pairs.reasons)}",
            grey=grey,
            picture=calibration.image.picture,
            image_px=pairs.image_px,
            intensity_px=pairs.intensity_px,
            accepted=pairs.accepted,
        )
    write_reprojection_curve(
        figures["reprojection"],
        heading,
        pairs=calibration.curve.pairs,
        unfiltered_px=calibration.curve.unfiltered_px,
        filtered_px=calibration.curve.filtered_px,
        held_out_px=calibration.estimate.reprojection_rms_px,
    )


def _overlay_panels(
    estimate: ExtrinsicsEstimate, given: CameraInput
) -> list[tuple[str, FloatArray, FloatArray]]:
    """The cloud's pixels and depths by the guess, where there is one, and by the result."""
    poses = [("result" if estimate.improved else "guess, kept", estimate.T_camera_lidar)]
    if estimate.T_guess is not None and estimate.improved:
        poses.insert(0, ("before: the guess", estimate.T_guess))
    points_m = _finite(given.cloud)
    points_m = points_m[:: max(1, len(points_m) // _OVERLAY_POINTS)]
    panels = []
    for title, T_camera_lidar in poses:
        seen = transform_points(T_camera_lidar, points_m)
        panels.append((title, project_points(seen, given.intrinsics), seen[:, 2]))
    return panels


def _finite(cloud: PointCloud) -> FloatArray:
    points_m = cloud.xyz_m.astype(np.float64)
    return points_m[np.isfinite(points_m).all(axis=1)]


def _write_colored(
    path: Path, given: CameraInput, T_camera_lidar: FloatArray, settings: CameraSettings
) -> int:
    """Write the points that the camera sees, in its colours (Fig. 12): how many."""
    rgb, seen = color_points(
        given.cloud.xyz_m, given.rgb, given.intrinsics, T_camera_lidar, settings.coloring
    )
    if not seen.any():
        raise ExportError("the camera sees no point of the cloud.", file=path)
    intensity = given.cloud.intensity
    write_cloud(
        path,
        given.cloud.xyz_m[seen].astype(np.float64),
        rgb[seen],
        None if intensity is None else intensity[seen],
    )
    return int(seen.sum())
