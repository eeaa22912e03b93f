"""A colour image that shows more than the depth image is noticed, and one that does not is left."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from fusion_core.slam.visual.color_zoom import ColorZoom, ColorZoomSettings, estimate_color_zoom
from fusion_core.slam.visual.features import FeatureSettings
from fusion_core.slam.visual.observation_noise import ObservationNoise
from fusion_core.workflows.map.visual.color_registration import magnify
from tests.slam.visual.textured_corner import INTRINSICS, frame, poses

COUNT = 60
FRAMES = [frame(T, k) for k, T in enumerate(poses(COUNT)[::2])]


def estimate(frames):
    settings = ColorZoomSettings()
    return estimate_color_zoom(frames, INTRINSICS, settings, FeatureSettings(), ObservationNoise())


@pytest.mark.parametrize("shown", [0.9, 1.08])
def test_the_zoom_is_found(shown):
    seen = [replace(f, gray=magnify(f.gray, shown, INTRINSICS)) for f in FRAMES]
    found = estimate(seen)
    assert found is not None
    assert found.is_significant
    assert found.zoom == pytest.approx(1.0 / shown, abs=max(4.0 * found.sigma, 0.01))


def test_registered_images_are_left_alone():
    found = estimate(FRAMES)
    assert found is None or not found.is_significant


def test_a_camera_that_stands_still_tells_nothing():
    still = [replace(FRAMES[0], stamp_ns=k) for k in range(30)]
    found = estimate(still)
    assert found is None or not found.is_significant


def test_images_without_depth_tell_nothing():
    blind = [replace(f, depth_m=np.full_like(f.depth_m, np.nan)) for f in FRAMES]
    assert estimate(blind) is None


def test_it_says_how_far_it_is():
    said = []

    def progress(done, total, _):
        said.append((done, total))

    settings = ColorZoomSettings(images_max=20)
    estimate_color_zoom(
        FRAMES,
        INTRINSICS,
        settings,
        FeatureSettings(),
        ObservationNoise(),
        progress,
        image_count=30,
    )
    assert said == [(0, 20), (6, 20), (12, 20), (18, 20)]


def test_what_is_certain_and_small_is_no_zoom():
    assert not ColorZoom(zoom=1.015, sigma=0.001, pairs=9).is_significant
    assert not ColorZoom(zoom=1.1, sigma=0.03, pairs=9).is_significant
    assert ColorZoom(zoom=1.1, sigma=0.01, pairs=9).is_significant


def test_magnified_about_the_principal_point():
    image = np.zeros((240, 320, 3), np.uint8)
    at = np.array([200, 150])
    cv2.circle(image, at.tolist(), 3, (255, 255, 255), -1)
    rows, columns = np.nonzero(magnify(image, 1.25, INTRINSICS)[..., 0] > 128)
    centre = np.array([INTRINSICS.cx, INTRINSICS.cy])
    expected = centre + 1.25 * (at - centre)
    np.testing.assert_allclose([columns.mean(), rows.mean()], expected, atol=0.5)
