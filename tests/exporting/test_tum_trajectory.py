"""Trajectory files written, and read back by the project's reader."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion_core.exporting.tum_trajectory import write_tum_trajectory
from fusion_core.model.errors import ExportError
from fusion_core.model.trajectory import Trajectory
from fusion_core.recordings.tum_trajectory import read_tum_trajectory

# Half of the last of nine digits, and what it turns a unit quaternion by at most.
POSITION_ROUNDING_M = 0.5e-9
ROTATION_ROUNDING_RAD = 2.5e-9

COORDINATE = st.floats(-1e5, 1e5)
POSES = st.lists(
    st.tuples(
        st.integers(0, 9_000_000_000_000_000_000),
        st.tuples(COORDINATE, COORDINATE, COORDINATE),
        st.tuples(*[st.floats(-3.2, 3.2)] * 3),
    ),
    min_size=1,
    max_size=5,
    unique_by=lambda pose: pose[0],
)


def trajectory(poses: list) -> Trajectory:
    ordered = sorted(poses)
    transforms = np.tile(np.eye(4), (len(ordered), 1, 1))
    transforms[:, :3, 3] = [position for _, position, _ in ordered]
    transforms[:, :3, :3] = Rotation.from_rotvec([turn for _, _, turn in ordered]).as_matrix()
    return Trajectory(
        stamps_ns=np.array([stamp for stamp, _, _ in ordered], dtype=np.int64),
        T_map_body=transforms,
    )


@given(POSES)
def test_it_reads_back(tmp_path_factory: pytest.TempPathFactory, poses: list) -> None:
    file = tmp_path_factory.mktemp("tum") / "trajectory.tum"
    before = trajectory(poses)
    write_tum_trajectory(file, before)
    read = read_tum_trajectory(file)
    assert read.warnings == ()
    assert np.array_equal(read.trajectory.stamps_ns, before.stamps_ns)
    moved_m = read.trajectory.T_map_body[:, :3, 3] - before.T_map_body[:, :3, 3]
    # A float64 of 1e5 m has steps of 1.5e-11 m itself.
    assert np.abs(moved_m).max() <= POSITION_ROUNDING_M + 2e-11
    turned = (
        Rotation.from_matrix(before.T_map_body[:, :3, :3]).inv()
        * Rotation.from_matrix(read.trajectory.T_map_body[:, :3, :3])
    ).magnitude()
    assert turned.max() <= ROTATION_ROUNDING_RAD


def test_the_bytes_are_fixed(tmp_path: Path) -> None:
    file = tmp_path / "trajectory.tum"
    path = trajectory(
        [
            (7, (0.1, -1e-12, 12345.6789), (0.0, 0.0, 0.0)),
            (1_700_000_000_000_000_001, (-0.5, 0.0, 0.0), (0.0, 0.0, -3.0)),
        ]
    )
    write_tum_trajectory(file, path)
    assert file.read_bytes() == (
        b"# timestamp tx ty tz qx qy qz qw\n"
        b"0.000000007 0.100000000 0.000000000 12345.678900000 "
        b"0.000000000 0.000000000 0.000000000 1.000000000\n"
        b"1700000000.000000001 -0.500000000 0.000000000 0.000000000 "
        b"0.000000000 0.000000000 -0.997494987 0.070737202\n"
    )
    assert [entry.name for entry in tmp_path.iterdir()] == ["trajectory.tum"]


def test_a_stamp_below_zero_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    file = tmp_path / "trajectory.tum"
    with pytest.raises(ExportError, match="-5 ns") as refused:
        write_tum_trajectory(file, Trajectory.from_planar(np.array([-5]), np.zeros((1, 3))))
    assert refused.value.file == str(file)
    assert list(tmp_path.iterdir()) == []
