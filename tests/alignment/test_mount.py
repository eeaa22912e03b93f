"""The mount of a camera on a LiDAR in simulated rooms, where the true one is known."""

import re
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
import pytest

from fusion_core.alignment.in_plane_mount import InPlaneMount, fit_in_plane
from fusion_core.alignment.mount import MountEstimate, estimate_mount, frame_yaw_offset_rad
from fusion_core.alignment.mount_cost import MountCost
from fusion_core.alignment.mount_observation import (
    MountObservation,
    mount_observation,
    remove_speckle,
)
from fusion_core.alignment.mount_refinement import (
    IN_PLANE,
    LineResiduals,
    ScanLines,
    refine_in_plane,
)
from fusion_core.alignment.mount_search import choose_mount
from fusion_core.alignment.mount_settings import MountPriors, MountSettings
from fusion_core.alignment.recorded_mount import find_refusal
from fusion_core.alignment.scan_motion import ScanMotion
from fusion_core.model.conventions import NS_PER_MS, NS_PER_S, R_BODY_OPTICAL
from fusion_core.model.errors import AlignmentFailed
from fusion_core.model.geometry import make_transform, transform_from_planar
from fusion_core.model.planar_poses import compose_poses, pose_after
from fusion_core.model.rig import MOUNT_PARAMETERS, Camera, Mount
from fusion_core.model.sensors import CameraIntrinsics, LaserScan

LENS = CameraIntrinsics(width=80, height=60, fx=70.0, fy=70.0, cx=39.5, cy=29.5)
CAMERA = Camera(
    topic="depth", intrinsics=LENS, T_rig_camera=make_transform(R_BODY_OPTICAL, np.zeros(3))
)
LIDAR_HEIGHT_M = 0.3
SETTINGS = MountSettings()


def noisy_ranges(ranges_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """1 cm of noise, holes, and burrs in front of the surface."""
    noisy = ranges_m + rng.normal(0.0, 0.01, ranges_m.shape)
    burr = rng.random(ranges_m.shape) < 0.02
    noisy = np.where(burr, ranges_m * rng.uniform(0.3, 0.9, ranges_m.shape), noisy)
    return np.where(rng.random(ranges_m.shape) < 0.03, np.nan, noisy)


def noisy_depth(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Noise that grows with depth, patches and speckles of holes, and burrs on both sides."""
    noisy = depth_m * (1.0 + rng.normal(0.0, 0.008, depth_m.shape))
    burr = rng.random(depth_m.shape) < 0.02
    noisy = np.where(burr, depth_m * rng.uniform(0.4, 1.3, depth_m.shape), noisy)
    noisy[rng.random(depth_m.shape) < 0.03] = np.nan
    for _ in range(4):
        row, column = rng.integers(0, 55), rng.integers(0, 72)
        noisy[row : row + 5, column : column + 8] = np.nan
    return noisy


def frame_at(
    room,
    mount: Mount,
    pose: tuple[float, float, float],
    *,
    rate: float = 0.0,
    known_rate: float | None = None,
    drive_m_s: tuple[float, float] = (0.0, 0.0),
    late_s: float = 0.0,
    extra_turn: float = 0.0,
    field_of_view_deg: float = 240.0,
    roll_rad: float = 0.0,
    rng: np.random.Generator | None = None,
) -> MountObservation:
    """A scan at ``pose`` (x, y, yaw), and an image ``late_s`` after it in true time.

    ``roll_rad`` of the camera about its axis, of which the observation does not know.
    """
    angles = np.deg2rad(np.arange(-field_of_view_deg / 2, field_of_view_deg / 2, 0.5))
    x, y, yaw = pose
    ranges_m = room.scan_m(x, y, LIDAR_HEIGHT_M, yaw, angles)
    moved = pose_after(np.array([*drive_m_s, rate]), late_s)
    moved[2] += extra_turn
    T_room_lidar = transform_from_planar(compose_poses(np.array(pose), moved))
    T_room_lidar[2, 3] = LIDAR_HEIGHT_M
    T_rig_camera = CAMERA.T_rig_camera.copy()
    # About the optical axis, the left side up.
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    T_rig_camera[:3, :3] = T_rig_camera[:3, :3] @ [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
    depth_m = room.depth_m(T_room_lidar @ mount.T_lidar_rig @ T_rig_camera, LENS)
    if rng is not None:
        ranges_m, depth_m = noisy_ranges(ranges_m, rng), noisy_depth(depth_m, rng)
    scan = LaserScan(
        stamp_ns=NS_PER_S,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=float(angles[0]),
        angle_increment_rad=float(np.deg2rad(0.5)),
        range_min_m=0.1,
        range_max_m=20.0,
        ranges_m=ranges_m,
    )
    stamp_ns = NS_PER_S + round(late_s * NS_PER_S + mount.clock_offset_ms * NS_PER_MS)
    known = rate if known_rate is None else known_rate
    velocity = np.array([*drive_m_s, known])
    motion = ScanMotion(velocity=velocity, turn_rate_sd_rad_s=0.02) if np.isfinite(known) else None
    return mount_observation(CAMERA, scan, depth_m.astype(np.float32), stamp_ns, motion)


def drive(
    room,
    mount: Mount,
    seed: int,
    *,
    rate: float | None = None,
    count: int = 16,
    late_s: tuple[float, float] = (-0.025, 0.025),
    **values: float,
) -> list[MountObservation]:
    """A drive around the middle of the room that turns at ``rate``, or at changing rates, with
    images that are late by values from ``late_s``."""
    rng = np.random.default_rng(seed)
    frames = []
    for angle in 2.0 * np.pi * np.arange(count) / count:
        x, y = rng.normal((3.0 + 0.7 * np.cos(angle), 2.4 + 0.6 * np.sin(angle)), 0.05)
        true_rate = float(rng.uniform(-0.7, 0.7)) if rate is None else rate
        frames.append(
            frame_at(
                room,
                mount,
                (x, y, 3.0 * angle + rng.normal(0.0, 0.2)),
                rate=true_rate,
                known_rate=true_rate + float(rng.normal(0.0, 0.02)),
                late_s=float(rng.uniform(*late_s)),
                rng=rng,
                **values,
            )
        )
    return frames


def random_mount(seed: int) -> Mount:
    half_widths = np.array([0.5, 0.2, 0.12, 0.1, 0.08, 50.0])
    values = np.random.default_rng(seed).uniform(-half_widths, half_widths)
    values[1] += 0.27
    return Mount.from_vector(values)


@dataclass(frozen=True)
class Trial:
    truth: Mount
    estimate: MountEstimate

    @property
    def errors(self) -> np.ndarray:
        return self.estimate.mount.vector() - self.truth.vector()

    @property
    def sd(self) -> np.ndarray:
        """NaN where not observable."""
        return np.array([np.nan if sd is None else sd for sd in self.estimate.mount.sd])


def trial(frames: list[MountObservation], truth: Mount, yaw_error_deg: float = 0.6) -> Trial:
    """An estimate that starts at a yaw with the error of an offset at one sample a degree."""
    yaw_rad = truth.yaw_rad + np.deg2rad(yaw_error_deg)
    return Trial(truth, estimate_mount(frames, SETTINGS, yaw_rad=float(yaw_rad)))


@pytest.fixture(scope="module")
def trials(furnished_room) -> list[Trial]:
    """Random mounts, each on its own drive through the furnished room."""
    found = []
    for seed in range(10):
        truth = random_mount(seed)
        yaw_error_deg = np.random.default_rng(seed).uniform(-1.0, 1.0)
        found.append(trial(drive(furnished_room, truth, seed), truth, yaw_error_deg))
    return found


def test_the_mount_is_recovered(trials: list[Trial]) -> None:
    errors = np.abs([one.errors for one in trials])
    typical = [np.deg2rad(0.6), 0.12, 0.02, 0.02, np.deg2rad(2.5), 5.0]
    largest = [np.deg2rad(1.2), 0.3, 0.06, 0.05, np.deg2rad(5.0), 12.0]
    assert (np.median(errors, axis=0) < typical).all()
    assert (errors.max(axis=0) < largest).all()
    for one in trials:
        assert one.estimate.is_confident
        assert not one.estimate.is_from_recorded
        assert one.estimate.agreement > 0.9
        assert one.estimate.visible > 0.9


def test_errors_are_no_larger_than_reported(trials: list[Trial]) -> None:
    normalised = np.array([one.errors / one.sd for one in trials])
    assert np.isfinite(normalised[:, [0, 2, 3, 5]]).all()
    assert np.isfinite(normalised).any(axis=0).all()
    rms = np.sqrt(np.nanmean(normalised**2, axis=0))
    assert (rms < 2.8).all(), dict(zip(MOUNT_PARAMETERS, rms, strict=True))
    assert np.sqrt(np.nanmean(normalised**2)) < 2.0


def test_the_profile_is_lowest_near_the_height(trials: list[Trial]) -> None:
    for one in trials:
        heights_m, costs = one.estimate.delta_z_profile.T
        assert heights_m.size > 10
        assert (np.diff(heights_m) > 0.0).all()
        if one.estimate.mount.sd[1] is None:
            continue
        assert abs(heights_m[costs.argmin()] - one.estimate.mount.delta_z_m) <= 0.06


def test_height_and_pitch_are_unobservable_in_a_plain_room(box_room) -> None:
    for seed in (0, 1, 2, 3):
        truth = random_mount(100 + seed)
        found = trial(drive(box_room(), truth, seed), truth)
        assert found.estimate.mount.sd[1] is None
        assert found.errors[0] == pytest.approx(0.0, abs=np.deg2rad(1.0))


@dataclass(frozen=True)
class BlockCosts:
    """Stands in for a MountCost: the costs of some yaws by blocks of frames, and the number of
    points in front of the camera, 100 unless told."""

    costs_of_yaw: dict[float, list[float]]
    in_front_of_yaw: dict[float, int] = field(default_factory=dict)

    def block_costs(self, values: np.ndarray) -> np.ndarray:
        return np.array(self.costs_of_yaw[float(values[0])])

    def mean_cost(self, values: np.ndarray) -> float:
        return float(self.block_costs(values).mean())

    def tallies_per_frame(self, values: np.ndarray) -> np.ndarray:
        return np.array([[np.nan, self.in_front_of_yaw.get(float(values[0]), 100), np.nan]])


@pytest.mark.parametrize(
    ("rival_costs", "chosen", "is_ambiguous"),
    [
        ([0.5, 0.6, 0.5, 0.6], 0.1, False),
        ([0.1, 0.3, 0.2, 0.22], 0.1, True),
        ([0.19, 0.21, 0.18, 0.2], 0.1, True),
        ([0.05, 0.06, 0.05, 0.06], 1.7, False),
    ],
    ids=["clearly worse", "a little worse", "a little better", "clearly better"],
)
def test_a_yaw_is_stated_where_its_rivals_are_clearly_worse(
    rival_costs: list[float], chosen: float, is_ambiguous: bool
) -> None:
    problem = BlockCosts(
        {0.1: [0.2, 0.21, 0.19, 0.2], 0.12: [0.2, 0.22, 0.2, 0.2], 1.7: rival_costs}
    )
    fits = [np.array([yaw, 0.0, 0.0, 0.0, 0.0, 0.0]) for yaw in problem.costs_of_yaw]
    best, found_ambiguous = choose_mount(cast(MountCost, problem), fits, yaw_rad=0.11)
    assert (best[0], found_ambiguous) == (chosen, is_ambiguous)


@pytest.mark.parametrize(("in_front", "is_rival"), [(49, False), (51, True)])
def test_a_camera_that_sees_too_little_is_no_rival(in_front: int, is_rival: bool) -> None:
    problem = BlockCosts(
        {0.1: [0.2, 0.21, 0.19, 0.2], 1.7: [0.05, 0.06, 0.05, 0.06]}, {1.7: in_front}
    )
    fits = [np.array([yaw, 0.0, 0.0, 0.0, 0.0, 0.0]) for yaw in problem.costs_of_yaw]
    best, is_ambiguous = choose_mount(cast(MountCost, problem), fits, yaw_rad=0.1)
    assert (best[0], is_ambiguous) == (1.7 if is_rival else 0.1, False)


@dataclass(frozen=True)
class GrowingLines:
    """Stands in for ScanLines: the residuals grow by ``growth`` from each mount to the next, while
    their derivative says that it is on the way to less."""

    growth: float
    seen: list[int] = field(default_factory=list)

    def residuals(self, values: np.ndarray, stretch: float) -> LineResiduals:
        self.seen.append(len(self.seen))
        spread = np.random.default_rng(0).normal(0.0, 1.0, (200, 6))
        return LineResiduals(
            values=self.growth ** self.seen[-1] * (1.0 + spread[:, 0]),
            jacobian=spread[:, 1:],
            line_error=np.zeros((200, 5)),
            rate_error=np.zeros((200, 5)),
            frame=np.arange(200) // 20,
            place=np.arange(200) % 20,
        )


@pytest.mark.parametrize(("growth", "holds"), [(1.1, False), (1.0, True), (0.95, True)])
def test_a_fit_that_runs_away_is_none(growth: float, holds: bool) -> None:
    priors = MountPriors.without_recorded(0.0, SETTINGS)
    free = np.ones(IN_PLANE.size, dtype=np.bool_)
    lines = cast(ScanLines, GrowingLines(growth))
    fit = refine_in_plane(lines, priors.centre.copy(), priors, free)
    assert (fit is not None) == holds


def test_another_height_is_tried_where_no_fit_holds(
    furnished_room, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the height that shows most, the pixels may be of table tops."""
    tried = []

    def fit_once(*given, **named) -> InPlaneMount:
        fit = fit_in_plane(*given, **named)
        tried.append(given[2][0])
        return fit if len(tried) > 1 else replace(fit, sd=np.full(fit.sd.shape, np.inf))

    monkeypatch.setattr("fusion_core.alignment.mount.fit_in_plane", fit_once)
    truth = random_mount(15)
    found = trial(drive(furnished_room, truth, 15), truth)
    assert len(tried) == 2
    assert tried[0][1] != tried[1][1]
    assert found.estimate.is_confident
    assert abs(found.errors[0]) < np.deg2rad(1.0)


def test_where_the_yaw_is_not_known_neither_is_what_goes_with_it(box_room) -> None:
    """A robot turns about the middle of a square room: a quarter of a turn changes next to
    nothing, though the true yaw agrees a little better than the others."""
    room = box_room(size_m=(5.0, 5.0, 2.6))
    rng = np.random.default_rng(0)
    truth = Mount(yaw_rad=0.1, delta_z_m=0.2, forward_m=0.04, left_m=-0.03)
    frames = []
    for turned in np.linspace(0.0, 2.0 * np.pi, 12):
        x, y = rng.normal(2.5, 0.02, 2)
        frames.append(frame_at(room, truth, (x, y, turned), rng=rng))
    estimate = trial(frames, truth).estimate
    assert estimate.agreement > 0.9
    assert not estimate.is_confident
    # Forward and left are along the yaw, and a delay turns it.
    assert [estimate.mount.sd[index] for index in (0, 2, 3, 5)] == [None] * 4


@pytest.mark.parametrize("drive_m_s", [(0.6, 0.0), (-0.4, 0.3)])
def test_a_drive_from_scan_to_image_does_not_move_the_mount(furnished_room, drive_m_s) -> None:
    """All images come 40 to 60 ms after their scans, in which the robot drives some 3 cm."""
    truth = random_mount(7)
    frames = drive(furnished_room, truth, 7, drive_m_s=drive_m_s, late_s=(0.04, 0.06))
    found = trial(frames, truth)
    assert (np.abs(found.errors[2:4]) < 0.012).all()
    assert (np.abs(found.errors[2:4]) < 4.0 * found.sd[2:4]).all()


def test_a_delay_moves_residuals_by_the_drive_in_it(furnished_room) -> None:
    """Against differences of the residuals whose pixels stay."""
    mount = random_mount(3)
    frames = drive(furnished_room, mount, 4, rate=0.0, count=4, drive_m_s=(0.5, -0.3))
    frames = [
        replace(one, motion=ScanMotion(velocity=np.array([0.5, -0.3, 0.0]), turn_rate_sd_rad_s=0.0))
        for one in frames
    ]
    lines = ScanLines(MountCost(frames, SETTINGS))
    values = mount.vector()
    late = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1e-3])
    before, after = lines.residuals(values - late), lines.residuals(values + late)
    middle = lines.residuals(values)
    assert before.values.size == middle.values.size == after.values.size
    slope = (after.values - before.values) / 2e-3
    same = np.isclose(slope, middle.jacobian[:, 3], rtol=1e-3, atol=1e-6)
    assert same.mean() > 0.95
    assert np.abs(slope).max() > 1e-3


@pytest.mark.parametrize("rate", [0.0, 0.4], ids=["standing still", "turning steadily"])
def test_the_clock_offset_is_observable_only_under_changing_turn_rates(
    furnished_room, rate: float
) -> None:
    for seed in (0, 1):
        truth = random_mount(100 + seed)
        found = trial(drive(furnished_room, truth, seed, rate=rate), truth)
        assert found.estimate.mount.sd[5] is None


def test_the_search_can_be_ended_at_every_mount_that_it_tries(furnished_room) -> None:
    truth = random_mount(3)
    frames = drive(furnished_room, truth, 3, count=8)
    tried = 0

    def count() -> None:
        nonlocal tried
        tried += 1

    estimate_mount(frames, SETTINGS, yaw_rad=truth.yaw_rad, on_step=count)
    assert tried > 1000
    for limit in (1, tried // 2, tried - 1):
        steps = iter(range(limit))

        def stop() -> None:
            if next(steps, None) is None:  # noqa: B023  # called before the loop goes on
                raise InterruptedError

        with pytest.raises(InterruptedError):
            estimate_mount(frames, SETTINGS, yaw_rad=truth.yaw_rad, on_step=stop)


def test_a_recorded_mount_is_the_prior(furnished_room) -> None:
    truth = random_mount(3)
    frames = drive(furnished_room, truth, 3)
    estimate = estimate_mount(
        frames, SETTINGS, yaw_rad=truth.yaw_rad + np.deg2rad(3.0), recorded=truth
    )
    assert estimate.is_from_recorded
    errors = np.abs(estimate.mount.vector() - truth.vector())
    assert (errors < [np.deg2rad(0.6), 0.02, 0.02, 0.02, np.deg2rad(0.7), 10.0]).all()
    assert all(sd is not None for sd in estimate.mount.sd[:5])


def test_a_recorded_yaw_is_compared_across_the_seam(furnished_room) -> None:
    truth = Mount(yaw_rad=np.pi - 0.01, delta_z_m=0.3)
    frames = drive(furnished_room, truth, 1, count=8, field_of_view_deg=360.0)
    # Its lever arm is wrong, so that too few points agree and the yaw decides.
    recorded = Mount(yaw_rad=truth.yaw_rad, delta_z_m=0.3, left_m=0.3)
    problem = MountCost(frames, SETTINGS)
    assert problem.agreement_and_visibility(recorded.vector())[0] < SETTINGS.min_agreement
    assert find_refusal(problem, recorded, SETTINGS, 0.02 - np.pi) == ""
    assert "past where scans and images fit best" in find_refusal(problem, recorded, SETTINGS, 0.5)


@dataclass(frozen=True)
class ShortDrive:
    """Eight frames of the furnished room, and their mount where none was recorded."""

    truth: Mount
    frames: list[MountObservation]
    without: MountEstimate

    def estimate(self, recorded: Mount) -> MountEstimate:
        yaw_rad = self.truth.yaw_rad
        return estimate_mount(self.frames, SETTINGS, yaw_rad=yaw_rad, recorded=recorded)


@pytest.fixture(scope="module")
def short_drive(furnished_room) -> ShortDrive:
    truth = random_mount(2)
    frames = drive(furnished_room, truth, 2, count=8)
    return ShortDrive(truth, frames, estimate_mount(frames, SETTINGS, yaw_rad=truth.yaw_rad))


@pytest.mark.parametrize(
    ("moved", "why"),
    [
        ({"forward_m": 1e6}, "it puts the camera 1e\\+06 m from the LiDAR, which sees no farther"),
        ({"forward_m": -1e6}, "which sees no farther than"),
        ({"delta_z_m": 1e6}, "which sees no farther than"),
        ({"left_m": 1.2}, "21% of the visible points agree, no more than by chance"),
        ({"forward_m": 0.5}, "3% of the visible points agree, no more than by chance"),
        ({"delta_z_m": -0.5}, "47% of the visible points agree under it, and 97% under the mount"),
    ],
)
def test_a_recorded_mount_that_explains_nothing_is_not_used(
    short_drive: ShortDrive, moved, why
) -> None:
    estimate = short_drive.estimate(replace(short_drive.truth, **moved))
    assert not estimate.is_from_recorded
    assert re.search(why, estimate.refusal)
    assert estimate.mount == short_drive.without.mount


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_right_mount_is_better_than_chance(furnished_room, seed: int) -> None:
    """``min_agreement`` is out of reach here, so that the mount is compared with chance."""
    truth = random_mount(seed)
    problem = MountCost(drive(furnished_room, truth, seed, count=8), SETTINGS)
    strict = SETTINGS.model_copy(update={"min_agreement": 1.0})
    for recorded in (truth, replace(truth, left_m=truth.left_m + 0.1)):
        assert problem.agreement_and_visibility(recorded.vector())[0] < 1.0
        assert find_refusal(problem, recorded, strict, None) == ""


def test_a_recorded_mount_that_contradicts_the_data_is_not_used(short_drive: ShortDrive) -> None:
    wrong = Mount(yaw_rad=short_drive.truth.yaw_rad + np.deg2rad(40.0), delta_z_m=0.2)
    with_wrong = short_drive.estimate(wrong)
    assert not with_wrong.is_from_recorded
    assert with_wrong.mount == short_drive.without.mount


def test_the_same_frames_give_the_same_mount(furnished_room) -> None:
    truth = random_mount(3)
    one, other = (
        estimate_mount(drive(furnished_room, truth, 4, count=5), SETTINGS, yaw_rad=truth.yaw_rad)
        for _ in range(2)
    )
    assert one.mount == other.mount
    np.testing.assert_array_equal(one.delta_z_profile, other.delta_z_profile)


def test_few_frames_do_not_determine_an_uncertainty(furnished_room) -> None:
    """Four frames have next to no spread: a mount is found, and is not confident."""
    truth = random_mount(3)
    frames = drive(furnished_room, truth, 4, count=4)
    estimate = estimate_mount(frames, SETTINGS, yaw_rad=truth.yaw_rad)
    assert estimate.mount.sd == (None,) * 6
    assert not estimate.is_confident


def test_too_few_frames_or_points_are_a_failure(furnished_room) -> None:
    truth = random_mount(3)
    frames = drive(furnished_room, truth, 4, count=4)
    with pytest.raises(AlignmentFailed, match="got 3"):
        estimate_mount(frames[:3], SETTINGS, yaw_rad=truth.yaw_rad)
    nothing = frames[0].scan.with_ranges(np.full(frames[0].scan.ranges_m.size, np.nan), None)
    blind = [
        mount_observation(CAMERA, nothing, frame.raw_depth_m, NS_PER_S, None) for frame in frames
    ]
    with pytest.raises(AlignmentFailed, match="100 LiDAR points"):
        estimate_mount(blind, SETTINGS, yaw_rad=truth.yaw_rad)


def test_a_frame_keeps_its_valid_points_and_stamps(furnished_room) -> None:
    mount = Mount(yaw_rad=0.3, clock_offset_ms=12.0)
    frame = frame_at(
        furnished_room,
        mount,
        (3.0, 2.4, 0.5),
        late_s=0.02,
        known_rate=float("nan"),
        rng=np.random.default_rng(0),
    )
    ranges_m, angles = frame.scan.ranges_m, frame.scan.angles_rad
    expected = [
        (r * np.cos(a), r * np.sin(a)) for r, a in zip(ranges_m, angles, strict=True) if r == r
    ]
    np.testing.assert_allclose(frame.points_m, expected, atol=1e-12)
    assert frame.image_after_scan_s == pytest.approx(0.032)
    assert frame.motion is None


@pytest.mark.parametrize("extra_deg", [-1.0, -0.5, 0.5, 1.0])
def test_an_extra_turn_of_one_frame_is_found(furnished_room, extra_deg: float) -> None:
    """Only partly: the prior reduces it, but never beyond the truth."""
    mount = Mount(yaw_rad=0.2, delta_z_m=0.25, forward_m=0.05, left_m=-0.04)
    fractions = []
    for seed, yaw in enumerate(np.arange(0.0, 6.0, 1.0)):
        frame = frame_at(
            furnished_room,
            mount,
            (3.0, 2.4, yaw),
            extra_turn=np.deg2rad(extra_deg),
            rng=np.random.default_rng(seed),
        )
        fractions.append(frame_yaw_offset_rad(frame, mount, SETTINGS) / np.deg2rad(extra_deg))
    assert 0.4 < np.median(fractions) < 1.1
    assert np.min(fractions) > -0.2


def test_a_plain_wall_does_not_change_a_frames_yaw(box_room) -> None:
    """A wall right ahead looks the same under a small turn, to first order."""
    mount = Mount(yaw_rad=0.0, delta_z_m=0.25)
    wall = box_room(size_m=(6.0, 40.0, 2.6))
    for extra_deg in (-0.5, 0.0, 0.5):
        frame = frame_at(wall, mount, (3.0, 20.0, 0.0), extra_turn=np.deg2rad(extra_deg))
        found = frame_yaw_offset_rad(frame, mount, SETTINGS)
        assert abs(found) < np.deg2rad(0.3)


def plane() -> np.ndarray:
    """A slanted wall, 24 by 32 pixels."""
    return np.tile(np.linspace(2.0, 2.3, 32, dtype=np.float32), (24, 1))


def test_isolated_values_are_removed_and_isolated_holes_filled() -> None:
    depth_m = plane()
    depth_m[5, 6], depth_m[15, 20] = 0.9, 4.0
    depth_m[10, 10] = np.nan
    clean = remove_speckle(depth_m)
    np.testing.assert_allclose(clean, plane(), atol=0.02)
    assert clean.dtype == np.float32


def test_every_other_pixel_is_filled() -> None:
    """Dark furniture: a chequered surface keeps its shape."""
    depth_m = plane()
    depth_m[::2, ::2] = np.nan
    depth_m[1::2, 1::2] = np.nan
    np.testing.assert_allclose(remove_speckle(depth_m)[2:-2, 2:-2], plane()[2:-2, 2:-2], atol=0.03)


def test_an_isolated_value_among_holes_is_removed() -> None:
    depth_m = np.full((24, 32), np.nan, dtype=np.float32)
    depth_m[12, 12] = 1.5
    assert np.isnan(remove_speckle(depth_m)).all()


def test_large_holes_stay() -> None:
    depth_m = plane()
    depth_m[6:18, 8:24] = np.nan
    clean = remove_speckle(depth_m)
    assert np.isnan(clean[8:16, 10:22]).all()
    np.testing.assert_allclose(clean[:5], plane()[:5], atol=0.02)


def test_no_value_between_two_surfaces_is_interpolated() -> None:
    rng = np.random.default_rng(0)
    depth_m = np.where(np.arange(32) < 16, np.float32(1.2), np.float32(2.9))
    depth_m = np.tile(depth_m, (24, 1))
    depth_m[rng.random(depth_m.shape) < 0.4] = np.nan
    clean = remove_speckle(depth_m)
    known = clean[np.isfinite(clean)]
    assert known.size > 300
    assert np.minimum(np.abs(known - 1.2), np.abs(known - 2.9)).max() < 1e-5


def test_the_image_is_unchanged() -> None:
    depth_m = plane()
    depth_m[3, 3] = np.nan
    before = depth_m.copy()
    remove_speckle(depth_m)
    np.testing.assert_array_equal(depth_m, before)
