"""The rows that ``fuse`` writes: frames.csv, samples.parquet and alignment.json."""

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from fusion_core.alignment.mount import MountEstimate
from fusion_core.alignment.panorama import PastedPanorama
from fusion_core.model.classes import NoiseClass, RepairSource, is_repaired
from fusion_core.model.conventions import NS_PER_MS, FloatArray
from fusion_core.model.rig import MOUNT_PARAMETERS, Mount
from fusion_core.workflows.fuse.align import RecordingAlignment
from fusion_core.workflows.fuse.camera_rig import CameraRig
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.pairing import PairedImage
from fusion_core.workflows.fuse.row_search import METRICS

if TYPE_CHECKING:
    import pyarrow as pa

_CLASS_COUNTS = [
    f"{sensor}_{noise.name.lower()}" for sensor in ("lidar", "depth") for noise in NoiseClass
]
FRAME_COLUMNS: tuple[str, ...] = (
    "camera",
    "stamp_ns",
    "scan_stamp_ns",
    "gap_ms",
    "u",
    "v",
    "score",
    "peak_ratio",
    "u_alone",
    "overlap",
    "row_model",
    "inliers",
    "mean_error_m",
    "sigma_m",
    "epsilon_m",
    *_CLASS_COUNTS,
    "repaired_lidar",
    "repaired_depth",
    *(f"u_{metric}" for metric in METRICS),
    *(f"u_alone_{metric}" for metric in METRICS),
    "registration_refused",
)


def sample_schema() -> "dict[str, pa.DataType]":
    """The columns of samples.parquet and their Arrow types."""
    import pyarrow as pa

    return {
        "camera": pa.dictionary(pa.int8(), pa.string()),
        "stamp_ns": pa.int64(),
        "scan_stamp_ns": pa.int64(),
        "lidar_beam": pa.int32(),
        "depth_row": pa.int32(),
        "depth_column": pa.int32(),
        "lidar_class": pa.int8(),
        "depth_class": pa.int8(),
        "lidar_confidence": pa.float32(),
        "depth_confidence": pa.float32(),
        "residual_m": pa.float64(),
        "lidar_raw_m": pa.float64(),
        "lidar_repaired_m": pa.float64(),
        "lidar_source": pa.dictionary(pa.int8(), pa.string()),
        "depth_raw_m": pa.float64(),
        "depth_repaired_m": pa.float64(),
        "depth_source": pa.dictionary(pa.int8(), pa.string()),
    }


_SOURCE_NAMES = np.array([source.name.lower() for source in RepairSource])


def unpaired_row(topic: str, entry: PairedImage) -> dict[str, object]:
    """The row of an image without a scan near in time, or without an offset of its own."""
    row: dict[str, object] = dict.fromkeys(FRAME_COLUMNS)
    row.update(camera=topic, stamp_ns=entry.image.stamp_ns)
    if entry.window is not None:
        row.update(scan_stamp_ns=entry.window.scan.stamp_ns, gap_ms=entry.gap_ns / NS_PER_MS)
    return row


def frame_row(
    topic: str, frame: FusedFrame, alignment: RecordingAlignment, rig: CameraRig
) -> dict[str, object]:
    """The row of a fused image. Depth is counted where the stored image has the pixel."""
    match = frame.match
    peak = match.search.peaks.get(alignment.metric)
    alone = match.search.peaks_without_prior.get(alignment.metric)
    registration = match.registration
    stored_row, _ = rig.views[match.pair.camera_index].stored_pixels(
        match.correspondence.row, match.correspondence.column
    )
    stored = stored_row >= 0
    row: dict[str, object] = dict.fromkeys(FRAME_COLUMNS)
    row.update(
        camera=topic,
        stamp_ns=match.stamp_ns,
        scan_stamp_ns=match.scan.stamp_ns,
        gap_ms=match.pair.gap_ns / NS_PER_MS,
        u_alone=None if alone is None else alone.u + match.u_of_rig,
        row_model=match.row_model,
        inliers=None if registration is None else int(registration.inliers.sum()),
        mean_error_m=None if registration is None else registration.mean_error_m,
        sigma_m=match.sigma_m,
        epsilon_m=frame.epsilon_m,
        repaired_lidar=int(is_repaired(frame.repair.lidar_source).sum()),
        repaired_depth=int(is_repaired(frame.repair.depth_source[stored]).sum()),
        registration_refused=match.refusal or None,
    )
    if peak is not None:
        row.update(
            u=peak.u + match.u_of_rig,
            v=peak.v,
            score=peak.score,
            peak_ratio=peak.ratio,
            overlap=peak.overlap,
        )
    for name, classes in (
        ("lidar", frame.classes.lidar_class),
        ("depth", frame.classes.depth_class[stored]),
    ):
        counts = np.bincount(classes[classes >= 0], minlength=len(NoiseClass)).tolist()
        for noise in NoiseClass:
            row[f"{name}_{noise.name.lower()}"] = counts[noise]
    for metric in METRICS:
        if metric in match.search.peaks:
            row[f"u_{metric}"] = match.search.peaks[metric].u + match.u_of_rig
        if metric in match.search.peaks_without_prior:
            row[f"u_alone_{metric}"] = match.search.peaks_without_prior[metric].u + match.u_of_rig
    return row


def sample_columns(topic: str, frame: FusedFrame, rig: CameraRig) -> dict[str, npt.NDArray[Any]]:
    """The rows of a fused image's beams, with pixels of the stored image."""
    match = frame.match
    pairs, classes, repaired = match.correspondence, frame.classes, frame.repair
    count = pairs.beam.size
    row, column = rig.views[match.pair.camera_index].stored_pixels(pairs.row, pairs.column)
    outside = row < 0

    def nullable(values: npt.NDArray[np.int64]) -> FloatArray:
        return np.where(outside, np.nan, values)

    return {
        "camera": np.full(count, topic),
        "stamp_ns": np.full(count, match.stamp_ns),
        "scan_stamp_ns": np.full(count, match.scan.stamp_ns),
        "lidar_beam": pairs.beam,
        "depth_row": nullable(row),
        "depth_column": nullable(column),
        "lidar_class": classes.lidar_class,
        "depth_class": nullable(classes.depth_class),
        "lidar_confidence": classes.lidar_confidence,
        "depth_confidence": np.where(outside, np.nan, classes.depth_confidence),
        "residual_m": pairs.residual_m,
        "lidar_raw_m": pairs.lidar_range_m,
        "lidar_repaired_m": repaired.lidar_range_m,
        "lidar_source": _SOURCE_NAMES[repaired.lidar_source],
        "depth_raw_m": pairs.depth_m,
        "depth_repaired_m": np.where(outside, np.nan, repaired.depth_m),
        "depth_source": _SOURCE_NAMES[
            np.where(outside, int(RepairSource.NONE), repaired.depth_source)
        ],
    }


def alignment_document(
    alignment: RecordingAlignment, rig: CameraRig, preset: str, *, virtual: bool, notes: list[str]
) -> dict[str, Any]:
    """alignment.json: offsets, mount with uncertainties, and the geometry behind the results."""
    peak, mount = alignment.peak, alignment.mount
    estimate = alignment.estimate
    scan = alignment.lidar
    return {
        "preset": preset,
        "virtual_lidar": virtual,
        "u": peak.u,
        "v": peak.v,
        "score": peak.score,
        "peak_ratio": _known(peak.ratio),
        "metric": alignment.metric,
        **_mount_entries(mount),
        **_roll_entries(rig, estimate),
        "by_metric": {
            metric: {
                "u": found.u,
                "v": found.v,
                "score": found.score,
                "peak_ratio": _known(found.ratio),
            }
            for metric, found in alignment.peaks.items()
        },
        "row_model": "curve" if alignment.along_curve else "row",
        "agreement": None if estimate is None else estimate.agreement,
        "visible": None if estimate is None else estimate.visible,
        "mount_used": dict(zip(MOUNT_PARAMETERS, mount.vector().tolist(), strict=True)),
        "recorded_mount_used": estimate is not None and estimate.is_from_recorded,
        **({} if rig.given is None else {"given_extrinsics": rig.given.source}),
        "noise_scale": {"floor_m": alignment.scale.floor_m, "share": alignment.scale.fraction},
        "frames": alignment.frames,
        "lidar": {
            "angle_min_rad": scan.angle_min_rad,
            "angle_increment_rad": scan.angle_increment_rad,
            "beams": scan.ranges_m.size,
            "range_max_m": _known(scan.range_max_m),
            "samples": alignment.curve.samples,
        },
        "cameras": [_camera_entry(rig, index, mount) for index in range(len(rig.cameras))],
        **_panorama_entry(alignment),
        "notes": notes,
    }


def _panorama_entry(alignment: RecordingAlignment) -> dict[str, Any]:
    """How the images of several cameras make a panorama; nothing where each is by itself."""
    panorama = alignment.panorama
    if panorama is None:
        return {}
    by_index = isinstance(panorama, PastedPanorama) and panorama.settings.by == "index"
    return {
        "panorama": {
            "cameras": [camera.topic for camera in panorama.from_left],
            "samples": panorama.sampling.columns.size,
            # Columns of the pasted images at equal steps; else azimuths about the rig's origin.
            "sampled_by": "index" if by_index else "angle",
        }
    }


def _mount_entries(mount: Mount) -> dict[str, float | None]:
    """Each value of the mount with its standard deviation, both null where not observable."""
    entries: dict[str, float | None] = {}
    for name, sd in zip(MOUNT_PARAMETERS, mount.sd, strict=True):
        entries[name] = None if sd is None else float(getattr(mount, name))
        entries[f"{name}_sd"] = None if sd is None else float(sd)
    return entries


def _roll_entries(rig: CameraRig, estimate: MountEstimate | None) -> dict[str, float | None]:
    """The rig's roll as floor or walls show it, null where not observable, and what the cameras'
    poses have of it; nothing where transforms are known, whose roll those poses have."""
    if estimate is None or rig.known_mount is not None:
        return {}
    tilt = estimate.tilt
    return {
        "roll_rad": None if tilt is None else tilt.roll_rad,
        "roll_rad_sd": None if tilt is None else tilt.roll_sd_rad,
        "roll_used_rad": estimate.roll_rad,
    }


def _camera_entry(rig: CameraRig, index: int, mount: Mount) -> dict[str, Any]:
    camera, view = rig.cameras[index], rig.full_views[index]
    height, width = view.stored_shape
    T_rig_stored = camera.T_rig_camera.copy()
    T_rig_stored[:3, :3] = camera.T_rig_camera[:3, :3] @ view.R_stored_view.T
    intrinsics = rig.stored_intrinsics[index]
    return {
        "topic": camera.topic,
        "width": width,
        "height": height,
        "fx": intrinsics.fx,
        "fy": intrinsics.fy,
        "cx": intrinsics.cx,
        "cy": intrinsics.cy,
        "calibrated": camera.calibrated,
        "T_rig_camera": T_rig_stored.tolist(),
        "T_lidar_camera": (mount.T_lidar_rig @ T_rig_stored).tolist(),
    }


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None
