"""Even spread of features, their depth, and their places without distortion."""

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.motion.feature_depths import sample_depths_m
from fusion_core.slam.visual.features import (
    FeatureExtractor,
    FeatureSettings,
    spread_evenly,
)
from tests.slam.visual.textured_corner import INTRINSICS, frame


@given(st.integers(0, 10_000), st.integers(1, 300), st.integers(1, 300))
def test_the_wanted_number_is_kept_strongest_first(seed, count, wanted):
    rng = np.random.default_rng(seed)
    pixels = rng.uniform(0.0, 640.0, (count, 2)).astype(np.float32)
    kept = spread_evenly(pixels, wanted)
    assert len(kept) == min(count, wanted)
    assert (np.diff(kept) > 0).all()
    # The strongest of all is the strongest of its cell.
    assert kept[0] == 0


def test_a_textured_corner_does_not_take_all():
    """Nine tenths of the corners, the strongest, lie in a sixteenth of the image."""
    rng = np.random.default_rng(3)
    crowded = rng.uniform(0.0, 160.0, (900, 2)) * [1.0, 0.75]
    rest = rng.uniform(0.0, 640.0, (100, 2)) * [1.0, 0.75]
    pixels = np.concatenate([crowded, rest]).astype(np.float32)
    kept = spread_evenly(pixels, 200)
    outside = np.count_nonzero((pixels[kept, 0] > 160.0) | (pixels[kept, 1] > 120.0))
    assert outside > 80
    assert np.count_nonzero(pixels[:200, 0] > 160.0) == 0


def test_features_of_half_an_image_with_weak_texture():
    rng = np.random.default_rng(0)
    blocks = cv2.resize(
        rng.integers(0, 256, (60, 80), dtype=np.uint8), (640, 480), interpolation=cv2.INTER_NEAREST
    ).astype(float)
    blocks[:, 320:] = 128.0 + 0.12 * (blocks[:, 320:] - 128.0)
    image = RgbdFrame(
        stamp_ns=0,
        gray=blocks.astype(np.uint8),
        depth_m=np.full((480, 640), 2.0, np.float32),
    )
    camera = CameraIntrinsics(width=640, height=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)
    features = FeatureExtractor(camera, FeatureSettings()).extract(image)
    weak = np.count_nonzero(features.pixels[:, 0] > 330.0)
    assert weak > 50
    strongest = cv2.ORB.create(nfeatures=len(features), fastThreshold=7).detect(image.gray, None)
    assert sum(point.pt[0] > 330.0 for point in strongest) < 0.5 * weak


def test_an_empty_image_has_no_features():
    dark = RgbdFrame(
        stamp_ns=0, gray=np.zeros((240, 320), np.uint8), depth_m=np.ones((240, 320), np.float32)
    )
    features = FeatureExtractor(INTRINSICS, FeatureSettings()).extract(dark)
    assert len(features) == 0
    assert features.descriptors.shape == (0, 32)


def test_descriptors_are_opencvs_at_the_same_keypoints():
    image = frame(np.eye(4), 0)
    settings = FeatureSettings(features_max=200)
    features = FeatureExtractor(INTRINSICS, settings).extract(image)
    keypoints = [
        cv2.KeyPoint(float(u), float(v), 31.0 * 1.2**octave, float(angle), 1.0, int(octave))
        for (u, v), octave, angle in zip(
            features.pixels, features.octaves, features.angles_deg, strict=True
        )
    ]
    kept, descriptors = cv2.ORB.create(nlevels=8).compute(image.gray, keypoints)
    np.testing.assert_allclose([point.pt for point in kept], features.pixels, atol=1e-4)
    np.testing.assert_array_equal(descriptors, features.descriptors)


def test_a_depth_edge_gives_no_depth():
    depth_m = np.full((240, 320), 2.0, np.float32)
    depth_m[:, 160:] = 3.0
    depth_m[100, 50] = np.nan
    image = RgbdFrame(stamp_ns=0, gray=np.zeros((240, 320), np.uint8), depth_m=depth_m)
    at = np.array([[100, 50], [159, 50], [160, 50], [200, 50], [50, 100], [51, 100]], np.float32)
    expected = [2.0, np.nan, np.nan, 3.0, np.nan, np.nan]
    np.testing.assert_allclose(sample_depths_m(image, at), expected)


def test_depth_of_half_the_size_is_the_same_places():
    u = np.mgrid[:120, :160][1]
    depth_m = (2.0 + 0.001 * (2 * u + 0.5)).astype(np.float32)
    image = RgbdFrame(stamp_ns=0, gray=np.zeros((240, 320), np.uint8), depth_m=depth_m)
    at = np.array([[20.0, 30.0], [201.0, 99.0]], np.float32)
    np.testing.assert_allclose(sample_depths_m(image, at), 2.0 + 0.001 * at[:, 0], atol=0.0011)
