"""Errors over relations: closed forms, and the published errors of the raw odometry of Intel."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.evaluation.relations import evaluate_relations
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.geometry import invert_transform, transform_from_planar
from fusion_core.model.relations import Relations
from fusion_core.model.sensors import PoseSample
from fusion_core.model.trajectory import Trajectory
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.relation_file import read_relations
from tests.evaluation.random_poses import random_transforms, random_walk

STAMPS_NS = 1_700_000_000_000_000_001 + np.arange(20, dtype=np.int64) * 100_000_000


def relations_of(trajectory: Trajectory, between: list[tuple[int, int]]) -> Relations:
    """What the trajectory itself says, at instants that may lie between its poses."""
    stamps_ns = np.array(between, dtype=np.int64)
    expected = [
        invert_transform(trajectory.pose_at(int(first))) @ trajectory.pose_at(int(second))
        for first, second in stamps_ns
    ]
    return Relations(
        first_stamps_ns=stamps_ns[:, 0].copy(),
        second_stamps_ns=stamps_ns[:, 1].copy(),
        T_first_second=np.array(expected),
    )


def one_relation(T_first_second: FloatArray) -> Relations:
    return Relations(
        first_stamps_ns=STAMPS_NS[:1].copy(),
        second_stamps_ns=STAMPS_NS[-1:].copy(),
        T_first_second=T_first_second[np.newaxis],
    )


@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.tuples(*[st.integers(0, 1_900_000_000)] * 2), min_size=1, max_size=5),
)
def test_errors_do_not_depend_on_the_map_frame(seed: int, between: list[tuple[int, int]]) -> None:
    trajectory = random_walk(STAMPS_NS.copy(), seed)
    start_ns = int(STAMPS_NS[0])
    relations = relations_of(trajectory, [(start_ns + a, start_ns + b) for a, b in between])
    elsewhere = Trajectory(
        stamps_ns=STAMPS_NS.copy(),
        T_map_body=random_transforms(1, seed, spread_m=50.0) @ trajectory.T_map_body,
    )
    report = evaluate_relations(elsewhere, relations)
    assert report.coverage == 1.0
    assert report.translation_m.max() < 1e-9
    assert report.cartographer_translation_m.max() < 1e-9
    assert report.rotation_rad.max() < 1e-7


def test_the_two_measures_differ_as_they_are_defined() -> None:
    """Measured: 2 m on and a quarter turn to the left. Expected: 1 m on, and no turn."""
    poses = np.zeros((20, 3))
    poses[-1] = 2.0, 0.0, np.pi / 2
    trajectory = Trajectory.from_planar(STAMPS_NS.copy(), poses)
    report = evaluate_relations(
        trajectory, one_relation(transform_from_planar(np.array([1.0, 0.0, 0.0])))
    )
    # In the first pose's frame, (2, 0) - (1, 0).
    assert report.translation_m == pytest.approx([1.0])
    # The expected step back from where it came to, a metre to the right: (2, 0) - (0, 1).
    assert report.cartographer_translation_m == pytest.approx([5.0**0.5])
    assert report.rotation_rad == pytest.approx([np.pi / 2])
    figures = report.to_json()
    assert figures["kuemmerle"]["rotation_deg"] == {"mean": pytest.approx(90.0), "std": 0.0}
    assert figures["cartographer"]["translation_squared_m2"]["mean"] == pytest.approx(5.0)


def test_mean_and_spread_are_over_all_relations() -> None:
    """Errors of 1, 2 and 6 m and 0, 0 and 60 degrees."""
    trajectory = Trajectory.from_planar(STAMPS_NS.copy(), np.zeros((20, 3)))
    expected = [(1.0, 0.0, 0.0), (0.0, -2.0, 0.0), (6.0, 0.0, np.radians(-60.0))]
    relations = Relations(
        first_stamps_ns=STAMPS_NS[[0, 5, 9]],
        second_stamps_ns=STAMPS_NS[[3, 2, 10]],
        T_first_second=np.array([transform_from_planar(np.array(pose)) for pose in expected]),
    )
    figures = evaluate_relations(trajectory, relations).to_json()["kuemmerle"]
    assert figures["translation_m"] == pytest.approx({"mean": 3.0, "std": (14 / 3) ** 0.5})
    assert figures["translation_squared_m2"]["mean"] == pytest.approx(41 / 3)
    assert figures["rotation_deg"] == pytest.approx({"mean": 20.0, "std": 800.0**0.5})
    assert figures["rotation_squared_deg2"]["mean"] == pytest.approx(1200.0)


def test_relations_beyond_the_trajectory_cost_coverage() -> None:
    trajectory = random_walk(STAMPS_NS.copy(), seed=1)
    first, last = int(STAMPS_NS[0]), int(STAMPS_NS[-1])
    relations = Relations(
        first_stamps_ns=np.array([first, first - 1, last, first]),
        second_stamps_ns=np.array([last, last, last + 1, first]),
        T_first_second=random_transforms(4, seed=2),
    )
    report = evaluate_relations(trajectory, relations)
    assert (report.relations, report.covered, report.coverage) == (4, 2, 0.5)
    # The last of the four asks for no motion at all.
    assert report.translation_m[1] == pytest.approx(
        float(np.linalg.norm(relations.T_first_second[3, :3, 3]))
    )


def test_relations_of_another_recording_are_refused() -> None:
    trajectory = Trajectory.from_planar(np.array([0, 10**9]), np.zeros((2, 3)))
    with pytest.raises(ScanLoomError, match=r"trajectory, 0\.000 s to 1\.000 s; they span 17"):
        evaluate_relations(trajectory, one_relation(np.eye(4)))


@pytest.mark.data
def test_raw_odometry_of_intel_has_its_published_error(data_folder: Path) -> None:
    """7.370 +- 14.349 m and 39.17 +- 53.79 degrees."""
    carmen = data_folder / "real" / "carmen"
    stamps_ns, poses = [], []
    with open_recording(carmen / "intel.clf.bz2") as recording:
        for message in recording.messages(["/flaser/odom"]):
            assert isinstance(message.value, PoseSample)
            stamps_ns.append(message.stamp_ns)
            poses.append(message.value.T_parent_child)
    order = np.argsort(stamps_ns)
    trajectory = Trajectory(
        stamps_ns=np.array(stamps_ns, dtype=np.int64)[order], T_map_body=np.array(poses)[order]
    )
    report = evaluate_relations(trajectory, read_relations(carmen / "intel.relations"))
    assert (report.relations, report.covered) == (2984, 2984)
    figures = report.to_json()["kuemmerle"]
    assert figures["translation_m"] == pytest.approx({"mean": 7.370, "std": 14.349}, abs=5e-4)
    assert figures["rotation_deg"] == pytest.approx({"mean": 39.17, "std": 53.79}, abs=5e-3)
