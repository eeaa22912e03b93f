"""Pose errors against closed forms, and against evo on a published estimate."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.evaluation.relative_pose import Step, StepUnit
from fusion_core.evaluation.statistics import ErrorStatistics
from fusion_core.evaluation.trajectories import Alignment, evaluate_trajectory
from fusion_core.model.conventions import NS_PER_S, FloatArray
from fusion_core.model.errors import ScanLoomError, SettingsError
from fusion_core.model.geometry import transform_from_planar
from fusion_core.model.trajectory import Trajectory
from fusion_core.recordings.tum_trajectory import read_tum_trajectory
from tests.evaluation.random_poses import random_transforms, random_walk

START_NS = 1_700_000_000_000_000_001
STAMPS_NS = START_NS + np.arange(40, dtype=np.int64) * 100_000_000


def moved(trajectory: Trajectory, T_other_map: FloatArray, scale: float = 1.0) -> Trajectory:
    poses = trajectory.T_map_body.copy()
    poses[:, :3, 3] *= scale
    return Trajectory(stamps_ns=trajectory.stamps_ns.copy(), T_map_body=T_other_map @ poses)


def test_the_seven_statistics() -> None:
    figures = ErrorStatistics.of(np.array([1.0, 2.0, 6.0, 3.0]))
    assert figures.to_json() == {
        "min": 1.0,
        "max": 6.0,
        "mean": 3.0,
        "median": 2.5,
        "variance": 3.5,
        "std": pytest.approx(3.5**0.5),
        "rmse": pytest.approx(12.5**0.5),
    }


@pytest.mark.parametrize("alignment", ["se3", "sim3"])
@given(seed=st.integers(0, 2**32 - 1))
def test_alignment_removes_the_pose_of_the_map(alignment: Alignment, seed: int) -> None:
    reference = random_walk(STAMPS_NS, seed)
    scale = 3.0 if alignment == "sim3" else 1.0
    estimate = moved(reference, random_transforms(1, seed + 1, spread_m=20.0)[0], scale)
    report = evaluate_trajectory(estimate, reference, alignment=alignment)
    assert report.ape_aligned is not None
    for errors in (report.ape_aligned, report.rpe):
        assert errors.translation_m.max() < 1e-9
        assert errors.rotation_rad.max() < 1e-7
    assert report.similarity is not None
    assert report.similarity.scale == pytest.approx(1.0 / scale)


def test_without_alignment_the_offset_is_the_error() -> None:
    reference = random_walk(STAMPS_NS, seed=2)
    estimate = moved(reference, transform_from_planar(np.array([3.0, 4.0, 0.0])))
    report = evaluate_trajectory(estimate, reference, alignment="none")
    assert report.ape.translation_m == pytest.approx([5.0] * 40)
    assert report.ape.rotation_rad.max() < 1e-7
    assert (report.ape_aligned, report.similarity) == (None, None)
    assert report.rpe.translation_m.max() < 1e-9
    figures = report.to_json()
    assert figures["absolute_aligned"] is None
    assert figures["absolute"]["translation_m"]["rmse"] == pytest.approx(5.0)


def test_a_rotated_body_is_an_error_of_rotation_only() -> None:
    reference = random_walk(STAMPS_NS, seed=3)
    turn = transform_from_planar(np.array([0.0, 0.0, np.radians(10.0)]))
    estimate = Trajectory(
        stamps_ns=reference.stamps_ns.copy(), T_map_body=reference.T_map_body @ turn
    )
    report = evaluate_trajectory(estimate, reference)
    assert report.ape_aligned is not None
    assert report.ape_aligned.translation_m.max() < 1e-9
    figures = report.to_json()["absolute_aligned"]["rotation_deg"]
    assert (figures["min"], figures["max"]) == (pytest.approx(10.0), pytest.approx(10.0))


@pytest.mark.parametrize(("unit", "delta"), [("s", 1.0), ("m", 1.0), ("frames", 4)])
def test_relative_errors_of_a_drift_grow_with_the_step(unit: StepUnit, delta: float) -> None:
    """25 cm straight on every 250 ms; the estimate says 1 % more and turns 0.1 degree a pose."""
    count = 40
    stamps_ns = START_NS + np.arange(count) * 250_000_000
    x_m, flat = np.arange(count) * 0.25, np.zeros(count)
    reference = Trajectory.from_planar(stamps_ns, np.stack([x_m, flat, flat], axis=1))
    turning = np.stack([1.01 * x_m, flat, np.radians(0.1) * np.arange(count)], axis=1)
    estimate = Trajectory.from_planar(stamps_ns, turning)
    for factor in (1, 2):
        step = Step(delta=factor * delta, unit=unit)
        report = evaluate_trajectory(
            estimate, reference, alignment="none", step=step, max_gap_s=1.0
        )
        figures = report.to_json()["relative"]
        assert figures["pairs"] == count - 4 * factor
        assert (figures["delta"], figures["unit"]) == (factor * delta, unit)
        assert figures["rotation_deg"]["mean"] == pytest.approx(factor * 0.4)
        # The step is straight in both, but seen from a body that is turned ever more.
        heading = np.radians(0.1) * np.arange(count - 4 * factor)
        expected = factor * np.hypot(1.01 * np.cos(heading) - 1.0, 1.01 * np.sin(heading))
        assert report.rpe.translation_m == pytest.approx(expected)


def test_in_the_plane_height_pitch_and_roll_are_ignored() -> None:
    reference = random_walk(STAMPS_NS, seed=4)
    flat = Trajectory.from_planar(STAMPS_NS.copy(), reference.planar_poses)
    estimate = moved(flat, transform_from_planar(np.array([5.0, -2.0, 1.2])))
    report = evaluate_trajectory(estimate, reference, alignment="se2")
    assert report.ape_aligned is not None
    assert report.ape_aligned.translation_m.max() < 1e-9
    assert report.ape_aligned.rotation_rad.max() < 1e-7
    assert report.ape.translation_m.max() > 1.0


def test_the_reference_is_interpolated_and_its_gaps_are_left_out() -> None:
    """Both move 1 m/s along x; the reference has no poses between 1 s and 2 s."""
    reference_s = np.array([0.0, 0.1, 0.9, 1.0, 2.0, 2.1])
    estimate_s = np.array([-0.5, 0.05, 0.95, 1.0, 1.5, 2.02, 2.5])

    def straight(at_s: FloatArray) -> Trajectory:
        flat = np.zeros(at_s.size)
        stamps_ns = START_NS + np.round(at_s * 1e9).astype(np.int64)
        return Trajectory.from_planar(stamps_ns, np.stack([at_s, flat, flat], axis=1))

    estimate, reference = straight(estimate_s), straight(reference_s)
    step = Step(delta=1, unit="frames")
    report = evaluate_trajectory(estimate, reference, alignment="none", step=step)
    assert report.ape.translation_m == pytest.approx([0.0] * 4, abs=1e-9)
    figures = report.to_json()
    assert (figures["associated"], figures["estimate_poses"]) == (4, 7)
    assert figures["associated_share"] == pytest.approx(4 / 7)
    assert figures["reference_poses"] == 6
    assert figures["coverage"] == pytest.approx((2.02 - 0.05) / 2.1)
    assert figures["longest_gap_s"] == pytest.approx(1.02)
    assert figures["path_m"] == pytest.approx(1.97)
    generous = evaluate_trajectory(
        estimate, reference, alignment="none", step=step, max_gap_s=1e300
    )
    assert generous.associated == 5


def test_poses_of_other_times_are_refused() -> None:
    estimate = Trajectory.from_planar(np.array([10**10]), np.zeros((1, 3)))
    reference = Trajectory.from_planar(np.array([0, 10**9]), np.zeros((2, 3)))
    with pytest.raises(ScanLoomError) as refused:
        evaluate_trajectory(estimate, reference)
    assert "estimate (10.000 s to 10.000 s)" in refused.value.problem
    assert "reference (0.000 s to 1.000 s)" in refused.value.problem


@pytest.mark.parametrize("gap_s", [0.0, -1.0, float("nan"), float("inf")])
def test_an_invalid_gap_is_refused(gap_s: float) -> None:
    one = Trajectory.from_planar(np.array([0]), np.zeros((1, 3)))
    with pytest.raises(SettingsError, match="the greatest gap must be positive"):
        evaluate_trajectory(one, one, max_gap_s=gap_s)


# What evo 1.38.1 says of ORB-SLAM on fr2/desk, associated by nearest stamps within 10 ms (2174
# poses), relative errors over all pairs along the reference: min, max, mean, median, std, rmse of
# the translation (m), then of the rotation (degrees).
KEYS = ("translation_m", "rotation_deg")
NAMES = ("min", "max", "mean", "median", "std", "rmse")
EVO_ABSOLUTE = {
    "none": (
        [1.4603443, 5.0667351, 2.9496939, 2.5946425, 1.1719816, 3.1739935],
        [130.8896690, 134.5161788, 132.4771694, 132.4539309, 0.6122957, 132.4785844],
    ),
    "se3": (
        [0.0003496, 0.0242996, 0.0074918, 0.0074146, 0.0031291, 0.0081190],
        [0.1329505, 2.0248712, 0.9594731, 0.9498012, 0.2400061, 0.9890357],
    ),
    "sim3": (
        [0.0001898, 0.0214768, 0.0055862, 0.0053052, 0.0025075, 0.0061232],
        [0.1329505, 2.0248712, 0.9594731, 0.9498012, 0.2400061, 0.9890357],
    ),
}
EVO_RELATIVE = {
    ("se3", "frames", 30): (
        2144,
        [0.0001650, 0.0325980, 0.0068620, 0.0064446, 0.0034976, 0.0077020],
        [0.0082442, 1.7402451, 0.4241138, 0.3714373, 0.2435943, 0.4890917],
    ),
    ("se3", "m", 0.5): (
        1981,
        [0.0002897, 0.0223261, 0.0084839, 0.0082944, 0.0034499, 0.0091585],
        [0.0376319, 1.6538114, 0.4696357, 0.4360029, 0.2381784, 0.5265801],
    ),
    ("sim3", "m", 2.0): (
        1783,
        [0.0012510, 0.0543929, 0.0132983, 0.0127774, 0.0062591, 0.0146976],
        [0.0630659, 1.8852748, 0.7414995, 0.6932095, 0.2929313, 0.7972642],
    ),
}


def associated_as_evo_does(folder: Path) -> tuple[Trajectory, Trajectory]:
    """The estimate, and the nearest true pose at each of its stamps.

    In float seconds, whose rounding decides where two true poses are equally near.
    """
    estimate = read_tum_trajectory(folder / "fr2_desk_ORB.txt").trajectory
    truth = read_tum_trajectory(folder / "fr2_desk_groundtruth.txt").trajectory
    own_s, true_s = (
        np.array([stamp_ns / NS_PER_S for stamp_ns in trajectory.stamps_ns.tolist()])
        for trajectory in (estimate, truth)
    )
    after = np.searchsorted(true_s, own_s).clip(1, true_s.size - 1)
    is_before = own_s - true_s[after - 1] <= true_s[after] - own_s
    nearest = after - is_before
    near = np.abs(own_s - true_s[nearest]) <= 0.01
    stamps_ns = estimate.stamps_ns[near]
    return (
        Trajectory(stamps_ns=stamps_ns.copy(), T_map_body=estimate.T_map_body[near]),
        Trajectory(stamps_ns=stamps_ns.copy(), T_map_body=truth.T_map_body[nearest[near]]),
    )


@pytest.mark.data
@pytest.mark.parametrize("alignment", ["none", "se3", "sim3"])
def test_absolute_errors_are_those_of_evo(alignment: Alignment, data_folder: Path) -> None:
    estimate, reference = associated_as_evo_does(data_folder / "real" / "trajectories")
    report = evaluate_trajectory(estimate, reference, alignment=alignment)
    assert report.associated == 2174
    figures = (report.ape_aligned or report.ape).to_json()
    for key, expected in zip(KEYS, EVO_ABSOLUTE[alignment], strict=True):
        assert [figures[key][name] for name in NAMES] == pytest.approx(expected, abs=1e-6), key


@pytest.mark.data
@pytest.mark.parametrize(("alignment", "unit", "delta"), list(EVO_RELATIVE))
def test_relative_errors_are_those_of_evo(
    alignment: Alignment, unit: StepUnit, delta: float, data_folder: Path
) -> None:
    estimate, reference = associated_as_evo_does(data_folder / "real" / "trajectories")
    step = Step(delta=delta, unit=unit)
    report = evaluate_trajectory(estimate, reference, alignment=alignment, step=step)
    figures = report.to_json()["relative"]
    pairs, *errors = EVO_RELATIVE[alignment, unit, delta]
    assert figures["pairs"] == pairs
    for key, expected in zip(KEYS, errors, strict=True):
        assert [figures[key][name] for name in NAMES] == pytest.approx(expected, abs=1e-6), key
