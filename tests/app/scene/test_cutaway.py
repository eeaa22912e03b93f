"""What hides a path is left out of a cloud, and nothing else."""

import numpy as np
import pytest

from scanloom.scene.camera_views import CameraView
from scanloom.scene.cutaway import hides_path, path_and_loops
from scanloom.scene.visual_picture import VisualPicture

AHEAD = CameraView(
    position_m=np.zeros(3), look_at_m=np.array([1.0, 0.0, 0.0]), up=np.array([0.0, 0.0, 1.0])
)
# Level, 4 m ahead, from half a metre to the left to half a metre to the right.
PATH_M = np.column_stack([np.full(200, 4.0), np.linspace(0.5, -0.5, 200), np.zeros(200)])


def hidden(*points_m: tuple[float, float, float], aspect: float = 1.6) -> list[bool]:
    points = np.array(points_m, dtype=np.float32)
    return hides_path(points, PATH_M.astype(np.float32), AHEAD, aspect).tolist()


@pytest.mark.parametrize("aspect", [0.46, 1.6])
def test_only_what_lies_before_the_path_is_left_out(aspect: float) -> None:
    before, behind, beside, above = (2.0, 0.0, 0.0), (5.0, 0.0, 0.0), (2.0, 0.6, 0.0), (2, 0, 0.3)
    assert hidden(before, behind, beside, above, aspect=aspect) == [True, False, False, False]


def test_what_is_at_the_path_or_out_of_sight_stays() -> None:
    assert hidden((3.95, 0.0, 0.0), (-2.0, 0.0, 0.0), (0.0, 0.0, 0.0)) == [False] * 3


def test_a_path_out_of_sight_is_hidden_by_nothing() -> None:
    behind_m = (PATH_M * (-1.0, 1.0, 1.0)).astype(np.float32)
    assert not hides_path(np.ones((5, 3), dtype=np.float32), behind_m, AHEAD, 1.6).any()


def test_loops_are_seen_as_the_path_is_without_its_lost_places() -> None:
    T_map_keyframe = np.tile(np.eye(4), (2, 1, 1))
    T_map_keyframe[1, 0, 3] = 2.0
    picture = VisualPicture(
        path_m=np.array([[0.0, 0.0, 0.0], [np.nan] * 3], dtype=np.float32),
        T_map_keyframe=T_map_keyframe,
        loops=np.array([[0, 1]]),
        points_m=np.zeros((0, 3), dtype=np.float32),
        rgb=np.zeros((0, 3), dtype=np.uint8),
    )
    along_m = path_and_loops(picture)
    assert np.isfinite(along_m).all()
    assert along_m[:, 0].min() == 0.0
    assert along_m[:, 0].max() == pytest.approx(2.0)
    assert np.diff(np.sort(along_m[:, 0])).max() < 0.1
