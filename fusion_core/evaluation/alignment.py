"""Errors of the estimated offset u, mount and clock against the truth.

The true u of a frame is the median, over its good pairs, of the offset of the row on the LiDAR
curve, lever arm included. The pairs are found with the truth only: the true point of each good beam
is projected through the true mount; the pair is good where the true pixel that it hits is good and
its horizontal range, seen from the LiDAR's origin, is within 10 cm of the beam's.

Where the images of several cameras make a panorama, a frame is a panorama: its true u is the median
over the good pairs of all its images, and it counts once.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.evaluation.associated_truth import (
    SAME_SURFACE_M,
    AssociatedTruth,
    associate_truth,
)
from fusion_core.evaluation.fuse_folder import (
    MISSING,
    Frames,
    FuseFolder,
    open_fuse_folder,
    read_frames,
)
from fusion_core.evaluation.true_samples import TrueRow, around_turn, true_row, turn_samples
from fusion_core.evaluation.truth import Truth
from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import FloatArray, IntArray, read_only, wrap_angle
from fusion_core.model.geometry import transform_points

# The definition of a hit: u within two samples (2 degrees at the paper's sampling) of the truth,
# counted over the frames in which at least half of the row overlaps the curve.
U_TOLERANCE_SAMPLES = 2.0
OVERLAP_MIN = 0.5
CLOCK_INTERVAL_SD = 2.0
"""Half width of the clock's interval in standard deviations, about 95 %."""

METRICS = ("pearson", "cosine", "inverse_cosine", "euclidean")

_SEARCHED = ("u", "v", "score", "u_alone")


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetHits:
    """How many of the ``frames`` that count have u within 2 samples of the truth."""

    frames: int
    within: int

    @property
    def fraction(self) -> float | None:
        """Hits / frames that count, None without frames."""
        return self.within / self.frames if self.frames else None


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignmentReport:
    """Alignment errors of one recording.

    ``u_true``: (F,) true u of each row of frames.csv, NaN where a frame has no good pair.
    ``hits``: for each column of offsets ("u", "u_alone", "u_<metric>", "u_alone_<metric>"), over
    the frames with a true u and an overlap of at least half; a frame without u is a miss.
    ``mount_error``: estimate - truth of each parameter of the mount, None where it was not
    observable; of several cameras the mean optical centre, heading and pitch. The clock's interval
    is its estimate +- 2 sd.
    """

    u_true: FloatArray
    hits: dict[str, OffsetHits]
    mount_error: dict[str, float | None]
    clock_offset_true_ms: float | None
    clock_interval_ms: tuple[float, float] | None

    def __post_init__(self) -> None:
        read_only(self.u_true)

    @property
    def yaw_error_deg(self) -> float | None:
        """Estimated - true yaw, None where none was estimated."""
        error_rad = self.mount_error["yaw_rad"]
        return None if error_rad is None else float(np.degrees(error_rad))

    @property
    def clock_contains_truth(self) -> bool | None:
        """Whether the interval contains the true offset, None where either is unknown."""
        if self.clock_interval_ms is None or self.clock_offset_true_ms is None:
            return None
        low, high = self.clock_interval_ms
        return low <= self.clock_offset_true_ms <= high

    def to_json(self) -> dict[str, Any]:
        """Hit fractions with their counts, errors of the mount and the clock's interval."""
        known = self.u_true[np.isfinite(self.u_true)]
        return {
            "u_true_median": float(np.median(known)) if known.size else None,
            "frames": int(self.u_true.size),
            "frames_with_true_u": int(known.size),
            "within_2_samples": {name: _hits_json(hits) for name, hits in self.hits.items()},
            "yaw_error_deg": self.yaw_error_deg,
            "mount_error": dict(self.mount_error),
            "clock_offset_true_ms": self.clock_offset_true_ms,
            "clock_interval_ms": None
            if self.clock_interval_ms is None
            else list(self.clock_interval_ms),
            "clock_contains_truth": self.clock_contains_truth,
        }


def _hits_json(hits: OffsetHits) -> dict[str, Any]:
    return {"share": hits.fraction, "within": hits.within, "frames": hits.frames}


def evaluate_alignment(fuse_dir: Path, truth: Truth) -> AlignmentReport:
    """Compare frames.csv and alignment.json in ``fuse_dir`` with ``truth``.

    Raises ScanLoomError where a file is invalid, folder and truth are of different recordings, or
    the truth has no mount.
    """
    folder = open_fuse_folder(fuse_dir)
    associated = associate_truth(truth, folder)
    frames = read_frames(folder)
    u_true = np.full(frames.stamp_ns.shape, np.nan)
    paired = np.flatnonzero(frames.scan_stamp_ns != MISSING)
    scan = associated.scan_index(frames.scan_stamp_ns[paired])
    image = associated.image_index(frames.camera[paired], frames.stamp_ns[paired])
    samples = true_row(associated, folder)
    turn = turn_samples(folder.lidar)
    offsets_of: dict[int, list[FloatArray]] = {}
    first_row = _first_rows(frames, folder)
    for frame, scan_index, image_index in zip(paired, scan, image, strict=True):
        offsets = _good_pair_offsets(
            associated, int(frames.camera[frame]), (int(scan_index), int(image_index)), samples
        )
        offsets_of.setdefault(int(first_row[frame]), []).append(offsets)
    for first, parts in offsets_of.items():
        offsets = np.concatenate(parts)
        if offsets.size:
            # A view may lie over the seam of a full circle.
            unwrapped = offsets[0] + around_turn(offsets - offsets[0], turn)
            u_true[first_row == first] = np.median(unwrapped)
    # Rows after a panorama's first repeat it.
    is_counted = first_row == np.arange(first_row.size)
    return AlignmentReport(
        u_true=u_true,
        hits=_count_hits(frames.number, np.where(is_counted, u_true, np.nan), turn),
        mount_error=_mount_error(folder, associated),
        clock_offset_true_ms=truth.clock_offset_ms,
        clock_interval_ms=_clock_interval_ms(folder),
    )


def pool_hits(reports: Sequence[AlignmentReport]) -> dict[str, OffsetHits]:
    """The hits over the frames of several recordings, for the columns that all of them have."""
    names = [name for name in reports[0].hits if all(name in own.hits for own in reports)]
    return {
        name: OffsetHits(
            frames=sum(report.hits[name].frames for report in reports),
            within=sum(report.hits[name].within for report in reports),
        )
        for name in names
    }


def _first_rows(frames: Frames, folder: FuseFolder) -> IntArray:
    """(F,) for each row of frames.csv the first row of its panorama, its own where it is alone.

    The images of a panorama follow each other and have one search.
    """
    first = np.arange(frames.stamp_ns.size)
    if "panorama" not in folder.alignment:
        return first
    searched = np.stack([frames.number[name] for name in _SEARCHED if name in frames.number])
    for row in range(1, first.size):
        of_panorama = slice(first[row - 1], row)
        is_same = (searched[:, row] == searched[:, row - 1]) | np.isnan(
            searched[:, row - 1 : row + 1]
        ).all(axis=1)
        if is_same.all() and frames.camera[row] not in frames.camera[of_panorama]:
            first[row] = first[row - 1]
    return first


def _good_pair_offsets(
    associated: AssociatedTruth,
    camera_index: int,
    scan_and_image: tuple[int, int],
    samples: TrueRow,
) -> FloatArray:
    """LiDAR sample of the beam - row sample of the pixel, of each good pair of an image."""
    scan, image = scan_and_image
    camera = associated.cameras[camera_index]
    beam = np.flatnonzero(associated.truth.kind[scan] == NoiseClass.GOOD)
    range_m = associated.truth.range_m[scan, beam]
    angle_rad = associated.beam_angle_rad[beam]
    points = np.stack([np.cos(angle_rad), np.sin(angle_rad), np.zeros(beam.size)], axis=-1)
    row, column, inside = camera.project(points * range_m[:, np.newaxis])
    shown: IntArray = np.full(beam.shape, image)
    depth_m = camera.truth.depth_m(shown, row, column)
    near = np.abs(camera.horizontal_range_m(row, column, depth_m) - range_m) < SAME_SURFACE_M
    good = inside & near & (camera.truth.kind[image, row, column] == NoiseClass.GOOD)
    in_lidar = transform_points(
        camera.T_lidar_camera, camera.back_project(row[good], column[good], depth_m[good])
    )
    of_pixels = samples.of_pixels(camera_index, row[good], column[good], in_lidar)
    return samples.of_beams(angle_rad[good]) - of_pixels


def _count_hits(
    number: dict[str, FloatArray], u_true: FloatArray, turn: float
) -> dict[str, OffsetHits]:
    counts = np.isfinite(u_true) & (number["overlap"] >= OVERLAP_MIN)
    names = [
        f"{column}{suffix}"
        for suffix in ("", *(f"_{metric}" for metric in METRICS))
        for column in ("u", "u_alone")
    ]
    return {
        name: OffsetHits(
            frames=int(counts.sum()),
            within=int(
                (
                    np.abs(around_turn(number[name] - u_true, turn))[counts] <= U_TOLERANCE_SAMPLES
                ).sum()
            ),
        )
        for name in names
        if name in number
    }


def _mount_error(folder: FuseFolder, associated: AssociatedTruth) -> dict[str, float | None]:
    true_mounts = [camera.T_lidar_camera for camera in associated.cameras]
    centre_m = np.mean([mount[:3, 3] for mount in true_mounts], axis=0)
    errors: dict[str, float | None] = {}
    for name, true_m in zip(("forward_m", "left_m", "delta_z_m"), centre_m, strict=True):
        estimate_m = folder.alignment.get(name)
        errors[name] = None if estimate_m is None else float(estimate_m - true_m)
    for name, angle_rad in (("yaw_rad", _heading_rad), ("pitch_rad", _pitch_rad)):
        if len(true_mounts) == 1:
            estimates = [folder.alignment.get(name)]
        else:
            # The axes of a rig are a convention; the headings of its cameras are physical.
            mounts = [camera.T_lidar_camera for camera in folder.cameras]
            estimates = [None if mount is None else angle_rad(mount) for mount in mounts]
        known = [
            wrap_angle(estimate_rad - angle_rad(mount))
            for estimate_rad, mount in zip(estimates, true_mounts, strict=True)
            if estimate_rad is not None
        ]
        errors[name] = float(np.mean(known)) if known else None
    return errors


def _heading_rad(T_lidar_camera: FloatArray) -> float:
    return float(np.arctan2(T_lidar_camera[1, 2], T_lidar_camera[0, 2]))


def _pitch_rad(T_lidar_camera: FloatArray) -> float:
    return float(-np.arcsin(np.clip(T_lidar_camera[2, 2], -1.0, 1.0)))


def _clock_interval_ms(folder: FuseFolder) -> tuple[float, float] | None:
    offset_ms = folder.alignment.get("clock_offset_ms")
    sd_ms = folder.alignment.get("clock_offset_ms_sd")
    if offset_ms is None or sd_ms is None:
        return None
    half_ms = CLOCK_INTERVAL_SD * float(sd_ms)
    return float(offset_ms) - half_ms, float(offset_ms) + half_ms
