"""Pass 1: the offset (u, v), the mount and the noise scale of a whole recording."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from fusion_core.alignment.curves import (
    CurveSampling,
    RowSampling,
    offset_of_yaw,
    row_samples_m,
    sample_curve,
    sample_row,
    yaw_of_offset_rad,
)
from fusion_core.alignment.given_mount import given_mount_sd, hold_given_mount
from fusion_core.alignment.interpolated_scan import scan_at_image
from fusion_core.alignment.mount import MountEstimate, estimate_mount, frame_yaw_offset_rad
from fusion_core.alignment.mount_observation import MountObservation, mount_observation
from fusion_core.alignment.panorama import Panorama, PastedPanorama, are_side_by_side
from fusion_core.alignment.scan_motion import estimate_motion
from fusion_core.alignment.search import MeanField, Peak, SearchSettings, find_peak
from fusion_core.alignment.similarity import Metric, SimilarityField
from fusion_core.denoising.correspondence import match_along_curve
from fusion_core.denoising.noise_scale import DATASHEET_SCALE, NoiseScale, learn_noise_scale
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import AlignmentFailed
from fusion_core.model.geometry import transform_from_planar
from fusion_core.model.progress import Progress, silent
from fusion_core.model.rig import Camera, Mount
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.pairing import FramePair, ImageGrouper, PairedImage
from fusion_core.workflows.fuse.pairing_gaps import PairingStamps
from fusion_core.workflows.fuse.row_search import METRICS, rows_to_search, search_rows
from fusion_core.workflows.fuse.session import Session
from fusion_core.workflows.fuse.settings import ChainSettings

# Angles are shown to this.
_SHOWN_DEG = 0.01
# Fields of this many frames make the mean; evenly spread, they see what all would.
_FIELD_FRAMES = 400


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingAlignment:
    """What pass 1 found. ``estimate`` is None where the pairs are taken frame by frame.

    ``curve`` and ``row`` sample the recording's field (a panorama's where there are several
    cameras). ``fields`` are the mean fields, ``peaks`` their peaks anywhere; ``peak`` is
    that of the metric that decides, at the mount's yaw. ``lidar``: a scan, for its geometry.
    ``panorama``: how a frame's images are searched together, None where each is by itself.
    ``unused_given``: the note on given extrinsics by which no pairs are taken.
    """

    fields: dict[Metric, SimilarityField]
    peaks: dict[Metric, Peak]
    peak: Peak
    metric: Metric
    curve: CurveSampling
    row: RowSampling
    mount: Mount
    estimate: MountEstimate | None
    scale: NoiseScale
    lidar: LaserScan
    frames: int
    panorama: Panorama | PastedPanorama | None = None
    unused_given: tuple[str, ...] = ()

    def panorama_for(self, settings: ChainSettings) -> Panorama | PastedPanorama | None:
        """The panorama of a frame's images with these settings, None where each is by itself."""
        own = self.panorama
        if own is None or (
            own.settings == settings.sampling
            and isinstance(own, PastedPanorama) == (settings.pairing == "frame")
        ):
            return own
        return make_panorama(own.cameras, settings)

    def on_rig(self, session: Session) -> Session:
        """The session that was aligned, with its rig rolled as the mount takes it to be."""
        if self.estimate is None or self.estimate.roll_rad == 0.0:
            return session
        return replace(session, rig=session.rig.rolled(self.estimate.roll_rad))

    @property
    def along_curve(self) -> bool:
        """Whether pairs lie along the projected curve (else in the row)."""
        return self.estimate is not None and self.estimate.is_confident

    @property
    def notes(self) -> tuple[str, ...]:
        """For people."""
        if self.estimate is None:
            return self.unused_given
        return tuple(_mount_notes(self.estimate)) + tuple(self._offset_notes())

    def _offset_notes(self) -> Iterator[str]:
        rows, used = self.peaks[self.metric], self.peak
        if self.along_curve and rows.u != used.u:
            yield (
                f"The offset u = {used.u:.1f} comes from the mount; the rows alone are most similar"
                f" at u = {rows.u:.1f} (score {rows.score:.3f}, there {used.score:.3f})."
            )


def _mount_notes(estimate: MountEstimate) -> Iterator[str]:
    if estimate.contradictions:
        yield (
            "The given extrinsics are used, but scans and images contradict them: "
            f"{'; '.join(estimate.contradictions)}."
        )
    elif not estimate.is_confirmed:
        yield (
            "The given extrinsics are used, but scans and images do not confirm them: "
            f"{estimate.visible:.0%} of the points in front of the camera are visible, and "
            f"{estimate.agreement:.0%} of these agree."
        )
    if estimate.moved_from_given:
        yield (
            "The given extrinsics are moved within their covariance to where scans and images agree"
            f" best: {estimate.moved_from_given}."
        )
    if estimate.refusal:
        found = "The mount is found from scans and images instead."
        yield f"{mount_not_used(estimate.refusal)} {found}"
    elif estimate.is_from_recorded and not estimate.is_confident:
        yaw = "; its yaw is not observable" if estimate.mount.sd[0] is None else ""
        yield (
            "The recorded mount is used, but scans and images do not confirm it: "
            f"{estimate.visible:.0%} of the points in front of the camera are visible, and "
            f"{estimate.agreement:.0%} of these agree{yaw}."
        )
    turned_deg = abs(np.rad2deg(0.01 * estimate.yaw_per_delay_rad_s))
    if estimate.mount.sd[0] is not None and turned_deg >= _SHOWN_DEG:
        yield (
            "The clock offset is not observable: the yaw is that of stamps of one clock, and each "
            f"10 ms between the clocks would turn it by {turned_deg:.2f} deg."
        )


def mount_not_used(refusal: str) -> str:
    """The note for people on a recorded mount that is refused."""
    return f"The recorded mount is not used: {refusal}."


def align_recording(
    session: Session, progress: Progress = silent, stamps: PairingStamps | None = None
) -> RecordingAlignment:
    """Pass 1: search the offset (u, v) over the recording, then refine the mount around it.

    ``stamps`` collects the stamps of all scans and images. The mount of a virtual LiDAR is the
    camera's own and is not refined.

    Raises AlignmentFailed where nothing pairs in time or no offset has a score, and RecordingError
    where most of a sensor's stamps are out of order.
    """
    # Sums of several threads would depend on the number of cores.
    with threadpool_limits(1, user_api="blas"):
        return _align(session, progress, stamps)


def _align(
    session: Session, progress: Progress, stamps: PairingStamps | None
) -> RecordingAlignment:
    rig, settings = session.rig, session.settings
    lidar = session.streams.lidar if session.virtual_row is None else None
    cameras = [camera.topic for camera in rig.cameras]
    session.geometry_filter.require_most_in_order(cameras if lidar is None else [lidar, *cameras])
    pairs = session.pairs() if stamps is None else stamps.observe(session.pairs())
    collected = _collect(pairs, session, progress)
    if collected.scan is not None and not collected.with_returns:
        raise AlignmentFailed(
            "no scan that is paired with a depth image has a range.",
            advice="Check the scanner, and the limits of the ranges in its driver.",
        )
    fields = {metric: collected.mean.mean(metric) for metric in METRICS}
    peaks = {metric: _peak_or_none(field, settings.search) for metric, field in fields.items()}
    metric = settings.search.metric
    known = {name: peak for name, peak in peaks.items() if peak is not None}
    if metric not in known or collected.scan is None or collected.curve is None:
        raise AlignmentFailed(
            f"the mean field of {collected.mean.frames} frames has no peak.",
            advice="Lower search.min_overlap, or check that both sensors see the same side.",
        )
    yaw_rad = yaw_of_offset_rad(known[metric].u, collected.curve, collected.row.left_rad)
    peak = known[metric]
    mount = Mount(yaw_rad=yaw_rad, sd=(np.deg2rad(1.0), *(None,) * 5))
    estimate = None
    unused_given: tuple[str, ...] = ()
    scale = DATASHEET_SCALE
    kept, panorama = collected.kept, collected.panorama
    calibrated = all(camera.calibrated for camera in rig.cameras)
    if session.virtual_row is None and calibrated and settings.pairing == "mount":

        def on_step() -> None:
            progress(0, None, "refining the mount")

        estimate = _estimate_mount(kept, session, yaw_rad, on_step)
        mount = estimate.mount
        if estimate.roll_rad != 0.0:
            rig = rig.rolled(estimate.roll_rad)
            kept = [frame.rolled(estimate.roll_rad) for frame in kept]
            panorama = make_panorama(rig.cameras, settings)
        u = offset_of_yaw(mount.yaw_rad, collected.curve, collected.row)
        peak = _peak_at(fields[metric], peak, u, settings.search)
        scale = _learn_scale(kept, mount, settings, on_step)
    elif rig.given is not None:
        mount = rig.given.mount
        unused_given = (
            "Beams and pixels are paired by each frame's own (u, v), not by the given extrinsics.",
        )
    return RecordingAlignment(
        fields=fields,
        peaks=known,
        peak=peak,
        metric=metric,
        curve=collected.curve,
        row=collected.row,
        mount=mount,
        estimate=estimate,
        scale=scale.with_quantization(rig.depth_quantum_m),
        lidar=collected.scan,
        frames=collected.mean.frames,
        panorama=panorama if are_side_by_side(rig.cameras) else None,
        unused_given=unused_given,
    )


def _estimate_mount(
    kept: list[MountObservation], session: Session, yaw_rad: float, on_step: Callable[[], None]
) -> MountEstimate:
    """The given mount where there is one, within its covariance where that is given too; else that
    of scans and images."""
    rig, settings = session.rig, session.settings.mount
    if rig.given is not None:
        return hold_given_mount(
            kept,
            settings,
            given=rig.given.mount,
            sd=given_mount_sd(rig.given.poses, settings),
            within_doubt=all(pose.covariance is not None for pose in rig.given.poses),
            on_step=on_step,
        )
    return estimate_mount(
        kept, settings, yaw_rad=yaw_rad, recorded=rig.recorded_mount, on_step=on_step
    )


def make_panorama(
    cameras: Sequence[Camera], settings: ChainSettings
) -> Panorama | PastedPanorama | None:
    """The panorama of a rig, None of one camera. Where each frame is paired by its own (u, v), as
    published, images side by side are pasted; else they are joined in 3D."""
    if len(cameras) < 2:
        return None
    if settings.pairing == "frame" and are_side_by_side(cameras):
        return PastedPanorama(cameras, settings.sampling)
    return Panorama(cameras, settings.sampling)


def _peak_at(field: SimilarityField, peak: Peak, u: float, search: SearchSettings) -> Peak:
    """The field's peak near the refined mount's ``u``, where the highest one lies elsewhere."""
    if abs(u - peak.u) <= search.runner_up_distance:
        return peak
    try:
        return find_peak(field, search, prior_u=u)
    except AlignmentFailed:
        return peak


def peak_of_mount(alignment: RecordingAlignment, mount: Mount, search: SearchSettings) -> Peak:
    """The peak of the deciding metric's mean field at another mount's offset."""
    metric = alignment.metric
    u = offset_of_yaw(mount.yaw_rad, alignment.curve, alignment.row)
    return _peak_at(alignment.fields[metric], alignment.peaks[metric], u, search)


class _AlignmentData:
    """What one pass over the recording collects: mean fields and a bounded subset of pairs."""

    def __init__(self, row: RowSampling, panorama: Panorama | PastedPanorama | None) -> None:
        self.panorama = panorama
        self.mean = MeanField()
        self.kept: list[MountObservation] = []
        self.curve: CurveSampling | None = None
        self.row = row
        self.scan: LaserScan | None = None
        self.with_returns = False

    @property
    def scan_size(self) -> int:
        return 0 if self.scan is None else self.scan.ranges_m.size


def _collect(
    pairs: Iterable[LaserScan | PairedImage], session: Session, progress: Progress
) -> _AlignmentData:
    rig, settings, image_count = session.rig, session.settings, session.image_count
    panorama = make_panorama(rig.cameras, settings)
    row = panorama.sampling if panorama else sample_row(rig.cameras[0], settings.sampling)
    collected = _AlignmentData(row, panorama)
    # The time span of the subset is the recording's, however long it is.
    field_every = max(1, image_count // len(rig.cameras) // _FIELD_FRAMES)
    keep_every = max(1, image_count // settings.mount.frames)
    seen = [0] * len(rig.cameras)
    grouper = ImageGrouper(len(rig.cameras), settings.time.max_gap_ms)
    views = 0
    for entry in pairs:
        if isinstance(entry, LaserScan):
            # The callback may cancel the run: there may be no images for long.
            progress(sum(seen), image_count, "matching scans with images")
            continue
        # Counted per camera, so that a regular order of the cameras leaves none out.
        seen[entry.camera] += 1
        progress(sum(seen), image_count, "matching scans with images")
        if entry.window is None:
            continue
        scan = entry.window.scan
        if collected.curve is None:
            collected.curve = sample_curve(scan, settings.sampling, width=row.columns.size)
            collected.scan = scan
        collected.with_returns |= bool(np.isfinite(scan.ranges_m).any())
        if seen[entry.camera] % keep_every == 0:
            pair = session.frame_pair(entry)
            assert pair is not None, "the image has a scan"
            collected.kept.append(observe_mount(pair, settings))
        for group in grouper.push(entry):
            if len(group) < len(rig.cameras):
                continue
            views += 1
            if views % field_every == 0 and scan.ranges_m.size == collected.scan_size:
                depths_m = [session.depth_of(own.camera, own.image.depth_m) for own in group]
                rows_m = (
                    panorama.samples_m(depths_m) if panorama else row_samples_m(depths_m[0], row)
                )
                aligned = scan_at_image(entry.window, entry.gap_ns, settings.time)
                rows = rows_to_search(rows_m, settings)
                collected.mean.add(search_rows(aligned, collected.curve, rows, settings))
    return collected


def observe_mount(pair: FramePair, settings: ChainSettings) -> MountObservation:
    """The observation of the mount by one pair."""
    return mount_observation(
        pair.camera,
        pair.scan,
        pair.depth_m,
        pair.scan.stamp_ns + pair.gap_ns,
        estimate_motion(pair.window, settings.time),
        pair.aligned_scan,
    )


def _peak_or_none(field: SimilarityField, settings: SearchSettings) -> Peak | None:
    try:
        return find_peak(field, settings)
    except AlignmentFailed:
        return None


def T_lidar_camera_at(camera: Camera, mount: Mount, moved: FloatArray) -> FloatArray:
    """(4, 4): a camera's optical frame at the image's stamp to the LiDAR frame at the scan's, in
    which the LiDAR has ``moved`` to the pose (3,)."""
    T_scan_image = transform_from_planar(moved)
    T_lidar_camera: FloatArray = T_scan_image @ mount.T_lidar_rig @ camera.T_rig_camera
    return T_lidar_camera


def motion_to_image(frame: MountObservation, mount: Mount, settings: ChainSettings) -> FloatArray:
    """(3,) pose of the LiDAR at the image's stamp in its frame at the scan's, as the stamps say,
    its yaw corrected by the frame's own check against the mount."""
    moved = np.zeros(3)
    if settings.time.compensate_motion and frame.motion is not None:
        moved = frame.motion.pose_after(frame.image_after_scan_s)
    if settings.mount.frame_yaw_sd_deg > 0.0:
        # A clock offset, where the user applies it, is in the stamps already.
        applied = replace(mount, clock_offset_ms=0.0)
        moved[2] += frame_yaw_offset_rad(frame, applied, settings.mount)
    return moved


def _learn_scale(
    kept: list[MountObservation],
    mount: Mount,
    settings: ChainSettings,
    on_step: Callable[[], None],
) -> NoiseScale:
    """The noise scale from the kept frames' own pairs. ``on_step`` is called before each."""
    ranges = []
    residuals = []
    for frame in kept:
        on_step()
        moved = motion_to_image(frame, mount, settings)
        pairs = match_along_curve(
            frame.scan,
            frame.raw_depth_m,
            frame.depth_m,
            frame.camera,
            T_lidar_camera_at(frame.camera, mount, moved),
        )
        ranges.append(pairs.lidar_range_m)
        residuals.append(pairs.residual_m)
    return learn_noise_scale(np.concatenate(ranges), np.concatenate(residuals))
