"""The camera of depth images of another size."""

from dataclasses import replace

import numpy as np
import pytest

from fusion_core.lens.projection import project_points
from fusion_core.mapping.depth_camera import depth_intrinsics
from fusion_core.model.errors import MappingFailed
from fusion_core.model.sensors import CameraIntrinsics

PINHOLE = CameraIntrinsics(width=160, height=120, fx=110.0, fy=112.0, cx=78.5, cy=61.0)


def test_the_camera_of_smaller_images_sees_the_same() -> None:
    half = depth_intrinsics(PINHOLE, (60, 80))
    # A pixel of the half covers two by two: its centre is where theirs meet.
    (pixel,) = project_points(np.array([[0.2, -0.1, 1.0]]), PINHOLE)
    (smaller,) = project_points(np.array([[0.2, -0.1, 1.0]]), half)
    np.testing.assert_allclose(smaller, (pixel - 0.5) / 2.0)


def test_an_impossible_size_is_refused() -> None:
    with pytest.raises(MappingFailed, match="a depth image of 1 x 1 pixels is not of a camera"):
        depth_intrinsics(replace(PINHOLE, fx=0.1, fy=0.1), (1, 1))
