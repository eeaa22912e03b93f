"""A LiDAR that sees a full circle, mounted at any yaw: what a frame gives does not depend on it.

The oracle is the same room seen by the same LiDAR whose seam lies behind the camera.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_core.alignment.curves import sample_curve, sample_row
from fusion_core.alignment.scan_motion import estimate_motion
from fusion_core.alignment.search import MeanField, find_peak
from fusion_core.alignment.similarity import SimilarityField
from fusion_core.alignment.time import ScanWindow
from fusion_core.alignment.upright import UprightView
from fusion_core.denoising.correspondence import match_by_sample
from fusion_core.denoising.noise_scale import DATASHEET_SCALE
from fusion_core.model.conventions import NS_PER_MS, R_BODY_OPTICAL
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.model.labels import Capture, CaptureLabels, Label
from fusion_core.model.planar_poses import transform_planar_points
from fusion_core.model.rig import Camera, Mount
from fusion_core.model.sensors import CameraIntrinsics, DepthImage, LaserScan
from fusion_core.workflows.fuse.align import RecordingAlignment
from fusion_core.workflows.fuse.frame import fuse_images
from fusion_core.workflows.fuse.frame_labels import FrameLabels, ImageLabels, ScanWindowLabels
from fusion_core.workflows.fuse.pairing import FramePair
from fusion_core.workflows.fuse.settings import PRESETS

BEAMS = 1080
STEP_RAD = 2.0 * np.pi / BEAMS
PERIOD_NS = 100 * NS_PER_MS
LENS = CameraIntrinsics(width=120, height=24, fx=110.0, fy=110.0, cx=58.7, cy=11.2)
CAMERA = Camera(
    topic="/depth", intrinsics=LENS, T_rig_camera=make_transform(R_BODY_OPTICAL, np.zeros(3))
)
MOUNT = Mount(yaw_rad=0.117, forward_m=0.06, left_m=-0.04, delta_z_m=0.11, pitch_rad=0.02)
HEIGHT_M = 0.35


def window_in_room(room) -> ScanWindow:
    """Three scans of a LiDAR that turns, with noise, holes and spikes; its seam is behind it."""
    rng = np.random.default_rng(4)
    angles = -np.pi + STEP_RAD * np.arange(BEAMS)
    scans = []
    for index in range(3):
        ranges_m = room.scan_m(2.6, 1.9, HEIGHT_M, 0.5 + 0.012 * (index - 1), angles)
        ranges_m = ranges_m + 0.008 * rng.normal(size=BEAMS)
        ranges_m[rng.random(BEAMS) < 0.06] = np.nan
        spikes = rng.random(BEAMS) < 0.05
        ranges_m[spikes] = rng.uniform(0.5, 3.0, int(spikes.sum()))
        first = int(rng.integers(440, 560))
        ranges_m[first : first + 12] = np.nan
        scans.append(scan_of(ranges_m, index * PERIOD_NS))
    return ScanWindow(before=scans[0], scan=scans[1], after=scans[2])


def scan_of(ranges_m: np.ndarray, stamp_ns: int = 0) -> LaserScan:
    return LaserScan(
        stamp_ns=stamp_ns,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=-np.pi,
        angle_increment_rad=STEP_RAD,
        range_min_m=0.05,
        range_max_m=12.0,
        ranges_m=ranges_m,
    )


def image_in_room(room) -> np.ndarray:
    """(H, W) depth at the second scan's instant, with noise, holes and speckle."""
    rng = np.random.default_rng(5)
    turn = rotation_from_yaw_pitch_roll(0.5, 0.0, 0.0)
    T_room_lidar = make_transform(turn, np.array([2.6, 1.9, HEIGHT_M]))
    depth_m = room.depth_m(T_room_lidar @ MOUNT.T_lidar_rig @ CAMERA.T_rig_camera, LENS)
    depth_m = depth_m + 0.004 * rng.normal(size=depth_m.shape)
    depth_m[rng.random(depth_m.shape) < 0.05] = np.nan
    depth_m[8:13, 40:46] = np.nan
    spikes = rng.random(depth_m.shape) < 0.03
    depth_m[spikes] = rng.uniform(0.5, 3.0, int(spikes.sum()))
    return depth_m.astype(np.float32)


def turned(window: ScanWindow, beams: int) -> ScanWindow:
    """The scans of the LiDAR mounted ``beams`` farther to the left."""

    def rolled(scan: LaserScan) -> LaserScan:
        return scan.with_ranges(np.roll(scan.ranges_m, -beams), None)

    return ScanWindow(
        before=rolled(window.before), scan=rolled(window.scan), after=rolled(window.after)
    )


def fused(window: ScanWindow, depth_m: np.ndarray, beams: int, preset: str, labels=None):
    """The frame of a LiDAR that is mounted ``beams`` farther to the left."""
    chain = PRESETS[preset]
    if preset == "default":
        # Each third of a sample is a whole beam, so that rounding decides nothing.
        search = chain.search.model_copy(update={"sub_samples": 3})
        chain = chain.model_copy(update={"search": search})
    back = rotation_from_yaw_pitch_roll(-beams * STEP_RAD, 0.0, 0.0)
    forward_m, left_m, _ = back @ np.array([MOUNT.forward_m, MOUNT.left_m, 0.0])
    mount = replace(
        MOUNT, yaw_rad=MOUNT.yaw_rad - beams * STEP_RAD, forward_m=forward_m, left_m=left_m
    )
    own = turned(window, beams)
    row = sample_row(CAMERA, chain.sampling)
    alignment = RecordingAlignment(
        fields={},
        peaks={},
        peak=None,
        metric=chain.search.metric,
        curve=sample_curve(own.scan, chain.sampling, width=row.columns.size),
        row=row,
        mount=mount,
        estimate=SimpleNamespace(is_confident=True),
        scale=DATASHEET_SCALE,
        lidar=own.scan,
        frames=1,
    )
    image = DepthImage(
        stamp_ns=own.scan.stamp_ns, received_ns=None, frame_id="camera", depth_m=depth_m
    )
    pair = FramePair(
        camera_index=0,
        camera=CAMERA,
        image=image,
        depth_m=depth_m,
        window=own,
        gap_ns=0,
        aligned_scan=own.scan,
    )
    return fuse_images([pair], alignment, chain, labels)[0]


@pytest.fixture(scope="module")
def seen(furnished_room):
    window, depth_m = window_in_room(furnished_room), image_in_room(furnished_room)
    return window, depth_m, {name: fused(window, depth_m, 0, name) for name in PRESETS}


def assert_same_frame(one, other, beams: int) -> None:
    """Pairs, classes and repairs are the same, but for the turned beams' numbers."""
    pairs, turned_pairs = one.match.correspondence, other.match.correspondence
    assert pairs.beam.size > 90
    np.testing.assert_array_equal(turned_pairs.beam, (pairs.beam - beams) % BEAMS)
    for name in ("row", "column"):
        np.testing.assert_array_equal(getattr(turned_pairs, name), getattr(pairs, name))
    for name in ("lidar_range_m", "depth_as_range_m", "camera_range_m", "residual_m"):
        np.testing.assert_allclose(
            getattr(turned_pairs, name), getattr(pairs, name), atol=1e-6, err_msg=name
        )
    steps = np.diff(turned_pairs.azimuth_rad)
    assert np.abs(steps).max() < 4.0 * STEP_RAD
    for name in ("lidar_class", "depth_class", "beam_support"):
        np.testing.assert_array_equal(getattr(other.classes, name), getattr(one.classes, name))
    for name in ("lidar_source", "depth_source"):
        np.testing.assert_array_equal(getattr(other.repair, name), getattr(one.repair, name))
    for name in ("lidar_range_m", "depth_m"):
        np.testing.assert_allclose(
            getattr(other.repair, name), getattr(one.repair, name), atol=1e-6, err_msg=name
        )


def difference(u: float, other: float) -> float:
    return (u - other + 180.0) % 360.0 - 180.0


# The view reaches over the seam where the LiDAR is mounted backwards.
ANY_TURN = st.integers(0, BEAMS - 1) | st.integers(480, 640)


@settings(max_examples=25, deadline=None)
@given(beams=ANY_TURN)
def test_a_frame_is_the_same_wherever_the_seam_lies(seen, beams) -> None:
    window, depth_m, plain = seen
    one, other = plain["default"], fused(window, depth_m, beams, "default")
    assert_same_frame(one, other, beams)
    peak, turned_peak = (own.match.search.peaks["euclidean"] for own in (one, other))
    assert -0.5 <= turned_peak.u < 359.5
    assert difference(turned_peak.u, peak.u + beams / 3.0) == pytest.approx(0.0, abs=0.3)
    if beams % 3 == 0:
        assert difference(turned_peak.u, peak.u + beams / 3.0) == pytest.approx(0.0, abs=1e-6)
        assert turned_peak.v == pytest.approx(peak.v)


def labels_of_beams(beams: int):
    """A person's labels of every third beam of the scans, mounted ``beams`` farther to the left."""
    plain = np.arange(0, BEAMS, 3)
    code = np.random.default_rng(7).choice([int(label) for label in Label], plain.size)

    def of_scan(stamp_ns: int) -> CaptureLabels:
        scan = Capture("lidar", "/scan", stamp_ns, 0, 1, BEAMS)
        return CaptureLabels.of_samples(scan, np.zeros_like(plain), (plain - beams) % BEAMS, code)

    lens = CAMERA.intrinsics
    view = UprightView(
        intrinsics=lens,
        stored_shape=(lens.height, lens.width),
        stored_index=None,
        R_stored_view=np.eye(3),
    )
    scans = ScanWindowLabels(before=of_scan(1), scan=of_scan(2), after=of_scan(3))
    labels = FrameLabels(scans=scans, images=(ImageLabels(stored=None, view=view),))
    return SimpleNamespace(of_match=lambda match: labels)


@settings(max_examples=10, deadline=None)
@given(beams=ANY_TURN)
def test_labels_hold_wherever_the_seam_lies(seen, beams) -> None:
    window, depth_m, plain = seen
    one = fused(window, depth_m, 0, "default", labels_of_beams(0))
    assert one.classes.lidar_decided.sum() > 20
    assert (one.repair.lidar_range_m != plain["default"].repair.lidar_range_m).sum() > 5
    assert_same_frame(one, fused(window, depth_m, beams, "default", labels_of_beams(beams)), beams)


def from_zero(scan: LaserScan) -> LaserScan:
    """The driver counts from straight ahead, in the middle of the view."""
    return replace(scan, angle_min_rad=0.0, ranges_m=np.roll(scan.ranges_m, -BEAMS // 2))


def clockwise(scan: LaserScan) -> LaserScan:
    """From straight ahead to the right."""
    ranges_m = np.roll(scan.ranges_m[::-1], BEAMS // 2 + 1)
    return replace(scan, angle_min_rad=0.0, angle_increment_rad=-STEP_RAD, ranges_m=ranges_m)


def ends_meet(scan: LaserScan) -> LaserScan:
    """The first direction is measured again as the last one."""
    return replace(scan, ranges_m=np.append(scan.ranges_m, scan.ranges_m[0]))


@pytest.mark.parametrize("driver", [from_zero, clockwise, ends_meet])
def test_a_frame_is_the_same_however_the_driver_counts(seen, driver) -> None:
    window, depth_m, plain = seen
    assert all(driver(scan).is_full_circle for scan in (window.before, window.scan))
    counted = ScanWindow(
        before=driver(window.before), scan=driver(window.scan), after=driver(window.after)
    )
    one, other = plain["default"], fused(counted, depth_m, 0, "default")
    pairs, counted_pairs = one.match.correspondence, other.match.correspondence
    order, counted_order = np.argsort(pairs.azimuth_rad), np.argsort(counted_pairs.azimuth_rad)
    np.testing.assert_allclose(
        counted_pairs.azimuth_rad[counted_order], pairs.azimuth_rad[order], atol=1e-9
    )
    assert counted_pairs.beam.size == pairs.beam.size
    np.testing.assert_array_equal(
        counted.scan.ranges_m[counted_pairs.beam], counted_pairs.lidar_range_m
    )
    for name in ("lidar_class", "depth_class"):
        np.testing.assert_array_equal(
            getattr(other.classes, name)[counted_order], getattr(one.classes, name)[order]
        )
    np.testing.assert_allclose(
        other.repair.lidar_range_m[counted_order], one.repair.lidar_range_m[order], atol=1e-6
    )


def test_a_scan_with_a_gap_behind_has_ends() -> None:
    assert not scan_of(np.ones(BEAMS - 4)).is_full_circle
    assert scan_of(np.ones(BEAMS - 4)).beam_behind(0.3) == 0


@settings(max_examples=25, deadline=None)
@given(turn=ANY_TURN)
def test_a_published_frame_is_the_same_wherever_the_seam_lies(seen, turn) -> None:
    window, depth_m, plain = seen
    # Samples are every third beam: by other turns, other beams.
    beams = turn // 3 * 3
    one, other = plain["published"], fused(window, depth_m, beams, "published")
    peak, turned_peak = (own.match.search.peaks["pearson"] for own in (one, other))
    assert difference(turned_peak.u, peak.u + beams / 3.0) == 0.0
    assert turned_peak.v == peak.v
    pairs, turned_pairs = one.match.correspondence, other.match.correspondence
    np.testing.assert_array_equal(turned_pairs.beam, (pairs.beam - beams) % BEAMS)
    for name in ("lidar_class", "depth_class"):
        np.testing.assert_array_equal(getattr(other.classes, name), getattr(one.classes, name))
    np.testing.assert_allclose(other.repair.lidar_range_m, one.repair.lidar_range_m, atol=1e-9)
    np.testing.assert_allclose(np.diff(turned_pairs.azimuth_rad), -3.0 * STEP_RAD, atol=1e-9)


def test_samples_beyond_the_seam_count_once_in_the_unit_of_a_sample(seen) -> None:
    """x of eq. (5) is the sample number times the median range times a degree."""
    window, depth_m, _ = seen
    chain = PRESETS["published"]
    row = sample_row(CAMERA, chain.sampling)
    curve = sample_curve(window.scan, chain.sampling, width=row.columns.size)
    assert curve.beams.size == 360 + row.columns.size - 1
    pairs, L, _ = match_by_sample(window.scan, depth_m, curve.beams, row.columns, 341.0, 12.0)
    spacing_m = np.nanmedian(window.scan.ranges_m[pairs.beam]) * np.deg2rad(1.0)
    np.testing.assert_allclose(np.diff(L[:, 0]), spacing_m)


@given(samples=st.integers(0, 359))
def test_the_field_of_a_full_circle_turns_with_it(seen, samples) -> None:
    window, depth_m, plain = seen
    other = fused(window, depth_m, 3 * samples, "published")
    field = plain["published"].match.search.fields["cosine"].scores
    turned_field = other.match.search.fields["cosine"].scores
    assert field.shape[1] == 360
    np.testing.assert_allclose(turned_field, np.roll(field, samples, axis=1), atol=1e-12)


def test_the_true_offset_is_found_over_the_seam(seen) -> None:
    window, depth_m, _ = seen
    preset, chain = "default", PRESETS["default"]
    row = sample_row(CAMERA, chain.sampling)
    for beams in (500, 540, 543, 600):
        found = fused(window, depth_m, beams, preset).match
        peak = found.search.peaks_without_prior[chain.search.metric]
        curve = sample_curve(found.scan, chain.sampling, width=row.columns.size)
        # The sample of the row's leftmost ray, by the azimuths of beams alone.
        yaw_rad = MOUNT.yaw_rad - beams * STEP_RAD
        towards = np.angle(np.exp(1j * (found.scan.angles_rad - row.left_rad - yaw_rad)))
        first = int(np.abs(towards).argmin())
        places = np.flatnonzero(np.abs(curve.beams[:360] - first) <= 1)
        assert difference(peak.u, float(places.mean())) == pytest.approx(0.0, abs=2.0)


def test_the_motion_turns_with_the_seam(seen) -> None:
    window, _, _ = seen
    chain = PRESETS["default"]
    motion = estimate_motion(window, chain.time)
    assert motion.turn_rate_rad_s == pytest.approx(0.12, abs=0.02)
    for beams in (3, 270, 541):
        again = estimate_motion(turned(window, beams), chain.time)
        in_turned = np.array([0.0, 0.0, -beams * window.scan.angle_increment_rad])
        drive = transform_planar_points(in_turned, motion.velocity[np.newaxis, :2])[0]
        np.testing.assert_allclose(again.velocity[:2], drive, atol=1e-9)
        assert again.turn_rate_rad_s == pytest.approx(motion.turn_rate_rad_s, abs=1e-9)


def field_of(scores: np.ndarray) -> SimilarityField:
    return SimilarityField(
        scores=scores, overlap=np.ones(scores.shape), u_first=0, turn_samples=float(scores.shape[1])
    )


@pytest.mark.parametrize("prior", [None, 27.4, 33.0])
@pytest.mark.parametrize("roll", range(60))
def test_a_peak_is_the_same_on_a_field_that_is_turned(roll: int, prior: float | None) -> None:
    """Against a field whose peak and whose runner-up are far from its ends."""
    rng = np.random.default_rng(2)
    scores = rng.uniform(0.0, 0.5, (4, 60))
    scores[2, 28:33] = [0.6, 0.8, 0.97, 0.9, 0.7]
    scores[1, 44] = 0.75
    search = PRESETS["default"].search.model_copy(update={"prior_samples": 9})
    plain = find_peak(field_of(scores), search, prior_u=prior)
    moved = find_peak(
        field_of(np.roll(scores, roll, axis=1)),
        search,
        prior_u=None if prior is None else prior + roll,
    )

    def around(u: float, other: float) -> float:
        return (u - other + 30.0) % 60.0 - 30.0

    assert around(moved.u, plain.u + roll) == pytest.approx(0.0, abs=1e-9)
    assert around(moved.runner_up_u, plain.runner_up_u + roll) == 0.0
    assert (moved.v, moved.score, moved.ratio) == (plain.v, plain.score, plain.ratio)


def test_a_mean_field_of_full_circles_is_one() -> None:
    mean = MeanField()
    mean.add({"pearson": field_of(np.ones((2, 12)))})
    assert mean.mean("pearson").turn_samples == 12.0
