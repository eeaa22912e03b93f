"""Something rigid that moves through the image is a second motion; what is wrong alone is none."""

import numpy as np
import pytest

from fusion_core.model.geometry import invert_transform, transform_points
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.slam.visual.doubtful_stretches import join_doubts
from fusion_core.slam.visual.frame_features import FrameFeatures
from fusion_core.slam.visual.observation_noise import ObservationNoise
from fusion_core.slam.visual.pinhole import camera_parameters, project
from fusion_core.slam.visual.pose_optimisation import exp_se3
from fusion_core.slam.visual.rival_motion import rival_share

CAMERA = CameraIntrinsics(width=640, height=480, fx=585.0, fy=585.0, cx=319.5, cy=239.5)
MOTION = exp_se3(np.array([0.02, 0.05, -0.01, 0.05, 0.02, 0.1]))
OTHER = exp_se3(np.array([0.0, 0.0, 0.0, 0.06, 0.0, 0.0]))


def two_views(moving_part: float, scattered: int = 0, seed: int = 0):
    """Features of a room in two images, of which those at the left, a part of the image, have a
    motion of their own; ``scattered`` ones are matched with anything."""
    rng = np.random.default_rng(seed)
    count = 600
    pixels = rng.uniform([0.0, 0.0], [640.0, 480.0], (count, 2))
    depths_m = rng.uniform(1.0, 4.0, count)
    moves = pixels[:, 0] < moving_part * 640.0
    camera = camera_parameters(CAMERA)
    points = np.column_stack([(pixels - camera[2:]) / camera[:2], np.ones(count)])
    points *= depths_m[:, np.newaxis]
    there = np.where(
        moves[:, np.newaxis],
        transform_points(OTHER @ MOTION, points),
        transform_points(MOTION, points),
    )
    seen = project(there, camera) + rng.normal(0.0, 0.7, (count, 2))
    seen[:scattered] = rng.uniform([0.0, 0.0], [640.0, 480.0], (scattered, 2))
    descriptors = rng.integers(0, 256, (count, 32), np.uint8)
    inside = ((seen >= 0.0) & (seen < [640.0, 480.0])).all(axis=1)

    def features(at, z, which):
        return FrameFeatures(
            pixels=at[which],
            depths_m=z[which],
            octaves=np.zeros(np.count_nonzero(which), np.int64),
            angles_deg=np.zeros(np.count_nonzero(which), np.float32),
            descriptors=descriptors[which],
        )

    everywhere = np.ones(count, np.bool_)
    return features(pixels, depths_m, everywhere), features(seen, there[:, 2], inside)


def share(first, second, motion=MOTION):
    return rival_share(first, second, motion, CAMERA, ObservationNoise())


@pytest.mark.parametrize("part", [0.2, 0.5, 0.7])
def test_the_part_that_moves_is_found(part):
    assert share(*two_views(part)) == pytest.approx(part, abs=0.1)


def test_the_rest_is_the_rival_where_the_pose_follows_what_moves():
    assert share(*two_views(0.6), OTHER @ MOTION) == pytest.approx(0.4, abs=0.1)


def test_a_room_that_stands_still_has_no_rival():
    assert share(*two_views(0.0)) == 0.0


def test_wrong_matches_agree_on_nothing():
    assert share(*two_views(0.0, scattered=200)) == 0.0


def test_images_without_a_match_say_nothing():
    first, _ = two_views(0.0, seed=1)
    other, _ = two_views(0.0, seed=2)
    assert share(first, other, invert_transform(MOTION)) == 0.0


def test_a_pause_does_not_part_a_doubt():
    shares = {0: 0.0, 5: 0.2, 10: 0.0, 15: 0.3, 30: 0.4}
    stamps = np.arange(40, dtype=np.int64)
    found = join_doubts(shares, stamps, 0.1, 5, 5, "of the image moves")
    assert [(s.first_stamp_ns, s.last_stamp_ns) for s in found] == [(1, 15), (26, 30)]
    assert found[0].reason == "up to 30 % of the image moves"
