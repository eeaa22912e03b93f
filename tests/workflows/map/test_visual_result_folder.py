"""What visual SLAM wrote is read back, and what two keyframes share is counted."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.exporting.clouds import write_cloud
from fusion_core.exporting.tum_trajectory import write_tum_trajectory
from fusion_core.model.conventions import NS_PER_S
from fusion_core.model.errors import ExportError
from fusion_core.model.trajectory import Trajectory
from fusion_core.workflows.map.visual_result_folder import (
    VisualResults,
    has_visual_results,
    read_run_cloud,
    read_visual_map,
    read_visual_results,
)

STAMPS_NS = np.arange(6, dtype=np.int64) * (NS_PER_S // 10) + 1_600_000_000_123_456_789


def poses(count: int) -> np.ndarray:
    """A camera that looks along the map's x axis and moves along it, 10 cm a step."""
    T = np.zeros((count, 4, 4))
    T[:, :3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    T[:, 0, 3] = 0.1 * np.arange(count)
    T[:, 3, 3] = 1.0
    return T


def results(seen: list[list[int]]) -> VisualResults:
    """Keyframes that see these landmarks; a feature's pixel tells its keyframe and its place."""
    count = len(seen)
    pixels = [[k, place] for k, landmarks in enumerate(seen) for place in range(len(landmarks))]
    return VisualResults(
        trajectory=Trajectory(stamps_ns=STAMPS_NS.copy(), T_map_body=poses(6)),
        stamps_ns=STAMPS_NS[:count].copy(),
        T_map_camera=poses(count),
        offsets=np.cumsum([0, *map(len, seen)]),
        pixels=np.array(pixels, dtype=np.float32).reshape(-1, 2),
        landmarks=np.array([one for landmarks in seen for one in landmarks], dtype=np.int64),
        landmarks_in_map_m=np.zeros((9, 3)),
        loops=np.empty((0, 2), dtype=np.int64),
        loop_inliers=np.empty(0, dtype=np.int64),
    )


@given(
    st.lists(
        st.lists(st.integers(0, 8), max_size=8, unique=True).map(lambda seen: [*seen, -1, -1]),
        min_size=2,
        max_size=5,
    )
)
def test_matches_are_the_landmarks_that_both_see(seen: list[list[int]]) -> None:
    held = results(seen)
    for first in range(len(seen)):
        counts = held.shared_counts(first)
        for second in range(len(seen)):
            both = sorted(set(seen[first]) & set(seen[second]) - {-1})
            in_first, in_second = held.matches(first, second)
            # By landmark, each where its own keyframe has it.
            assert in_first.tolist() == [[first, seen[first].index(one)] for one in both]
            assert in_second.tolist() == [[second, seen[second].index(one)] for one in both]
            assert counts[second] == (0 if second == first else len(both))


def write(folder: Path, held: VisualResults, loops: list[list[int]]) -> None:
    write_tum_trajectory(folder / "trajectory.tum", held.trajectory)
    np.savez(
        folder / "visual_map.npz",
        stamps_ns=held.stamps_ns,
        T_map_camera=held.T_map_camera,
        offsets=held.offsets,
        pixels=held.pixels,
        landmarks=held.landmarks,
        landmarks_in_map_m=held.landmarks_in_map_m,
        loops=np.array(loops, dtype=np.int64).reshape(-1, 2),
        loop_inliers=np.full(len(loops), 40),
    )
    first, last = (float(STAMPS_NS[number]) / NS_PER_S for number in (2, 3))
    report = {"slam": "visual", "lost": [{"from_s": first, "to_s": last}], "notes": []}
    (folder / "report.json").write_text(json.dumps(report), encoding="utf-8")


def test_a_folder_is_read_back(tmp_path: Path) -> None:
    held = results([[0, 1, 2], [1, 2, 5], [2]])
    assert not has_visual_results(tmp_path)
    write(tmp_path, held, [[0, 2]])
    points_m = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    rgb = np.array([[1, 2, 3], [255, 128, 0]], dtype=np.uint8)
    write_cloud(tmp_path / "cloud.ply", points_m, rgb)
    assert has_visual_results(tmp_path)
    back = read_visual_results(tmp_path)
    np.testing.assert_array_equal(back.stamps_ns, held.stamps_ns)
    np.testing.assert_array_equal(back.trajectory.stamps_ns, STAMPS_NS)
    np.testing.assert_array_equal(back.pixels, held.pixels)
    cloud_in_map_m, cloud_rgb = read_run_cloud(tmp_path)
    np.testing.assert_array_equal(cloud_in_map_m, points_m.astype(np.float32))
    np.testing.assert_array_equal(cloud_rgb, rgb)
    assert back.loops.tolist() == [[0, 2]]
    seen = read_visual_map(tmp_path, back)
    # The camera looks where it goes: as a body it has no turn at all.
    np.testing.assert_allclose(seen.trajectory.planar_poses[:, 2], 0.0, atol=1e-6)
    assert seen.trusted.tolist() == [True, True, False, False, True, True]
    np.testing.assert_allclose(seen.loops_m, [[0.0, 0.0, 0.2, 0.0]], atol=1e-9)


def test_a_camera_beside_a_lidar_has_a_trajectory_of_its_own(tmp_path: Path) -> None:
    held = results([[0], [0]])
    write(tmp_path, held, [])
    other = Trajectory(stamps_ns=STAMPS_NS[:2].copy(), T_map_body=poses(2))
    write_tum_trajectory(tmp_path / "trajectory_camera.tum", other)
    back = read_visual_results(tmp_path)
    assert back.trajectory.stamps_ns.size == 2
    assert len(read_run_cloud(tmp_path)[0]) == 0


@pytest.mark.parametrize(
    "spoil",
    [
        lambda folder: (folder / "visual_map.npz").write_bytes(b"PK nonsense"),
        lambda folder: (folder / "trajectory.tum").unlink(),
        lambda folder: write(folder, results([[0], [0]]), [[0, 7]]),
        lambda folder: np.savez(folder / "visual_map.npz", stamps_ns=np.arange(3)),
    ],
    ids=["no archive", "no trajectory", "a loop to nowhere", "arrays missing"],
)
def test_a_spoilt_folder_is_refused_in_one_line(tmp_path: Path, spoil: object) -> None:
    write(tmp_path, results([[0], [0]]), [])
    spoil(tmp_path)  # type: ignore[operator]
    with pytest.raises(ExportError, match="cannot be read back") as caught:
        read_visual_results(tmp_path)
    assert "\n" not in str(caught.value)
