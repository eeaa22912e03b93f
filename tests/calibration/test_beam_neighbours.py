"""Depth steps and intensity contrast of neighbouring beams."""

import numpy as np
import pytest

from fusion_core.calibration.refinement.beam_neighbours import (
    find_beam_neighbours,
    find_depth_steps,
    intensity_contrast,
    turns_full_circle,
)

AZIMUTH, ELEVATION = (
    grid.ravel()
    for grid in np.meshgrid(
        np.radians(np.arange(-20.0, 20.01, 0.25)), np.radians(np.arange(-10.0, 10.01, 0.5))
    )
)
RAYS = np.stack(
    [
        np.cos(ELEVATION) * np.cos(AZIMUTH),
        np.cos(ELEVATION) * np.sin(AZIMUTH),
        np.sin(ELEVATION),
    ],
    axis=1,
)


def steps_of(range_m):
    near = find_beam_neighbours(RAYS * range_m[:, np.newaxis])
    return find_depth_steps(near, slope_min=10.0, sideways_gaps_are_sky=False)


def test_the_beams_lie_a_quarter_of_a_degree_apart():
    near = find_beam_neighbours(RAYS * 7.0)
    assert np.degrees(near.spacing_rad) == pytest.approx(0.25, rel=0.02)


def test_second_returns_of_a_beam_are_not_its_neighbours():
    twice = np.concatenate([RAYS * 7.0, RAYS * 9.0])
    assert np.degrees(find_beam_neighbours(twice).spacing_rad) == pytest.approx(0.25, rel=0.02)


def test_planes_have_no_step_however_they_are_seen():
    wall_m = 8.0 / RAYS[:, 0]
    slanted_m = 8.0 / (RAYS @ np.array([0.5, 0.8, 0.33]))
    assert not steps_of(wall_m).is_step.any()
    assert not steps_of(slanted_m).is_step.any()
    # Ground, at an angle of incidence of up to 88 degrees.
    below = np.degrees(ELEVATION) < -1.9
    ground_m = 1.7 / -np.sin(ELEVATION[below])
    near = find_beam_neighbours(RAYS[below] * ground_m[:, np.newaxis])
    assert not find_depth_steps(near, slope_min=10.0, sideways_gaps_are_sky=False).is_step.any()


def test_a_post_has_a_step_on_either_side_and_between_the_beams():
    post = np.abs(np.degrees(AZIMUTH)) < 2.1
    steps = steps_of(np.where(post, 5.0, 12.0))
    found = steps.points_in_lidar_m[steps.is_step]
    # Between the last beam of the post, at 2.0 degrees, and the next one; at the post's range.
    azimuth_deg = np.degrees(np.arctan2(found[:, 1], found[:, 0]))
    assert np.abs(np.abs(azimuth_deg) - 2.125).max() < 0.01
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 5.0, rtol=1e-9)
    rings = np.unique(ELEVATION).size
    assert len(found) == 2 * rings
    # To the left of the left side, to the right of the right one.
    assert (np.sign(steps.towards[steps.is_step, 1]) == np.sign(azimuth_deg)).all()


def test_a_gap_beside_is_sky_for_a_scanner_that_turns():
    post = np.abs(np.degrees(AZIMUTH)) < 2.1
    near = find_beam_neighbours(RAYS[post] * 5.0)
    alone = find_depth_steps(near, slope_min=10.0, sideways_gaps_are_sky=False)
    assert not alone.is_step.any()
    turning = find_depth_steps(near, slope_min=10.0, sideways_gaps_are_sky=True)
    assert turning.is_step.sum() == 2 * np.unique(ELEVATION).size


def test_who_turns_all_around():
    azimuth = np.radians(np.arange(0.0, 360.0, 0.5))
    circle = np.stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth], axis=1)
    assert turns_full_circle(circle)
    assert not turns_full_circle(RAYS)


def test_contrast_forgets_what_changes_slowly_and_the_unit():
    rng = np.random.default_rng(5)
    stripes = np.where(np.floor(np.degrees(AZIMUTH)) % 2 == 0, 1.0, 2.0) + rng.normal(
        0.0, 0.02, AZIMUTH.size
    )
    near = find_beam_neighbours(RAYS * 9.0)
    of = {"radius_rad": np.radians(2.0), "slope_max": 10.0}
    contrast = intensity_contrast(near, stripes, **of)
    np.testing.assert_allclose(intensity_contrast(near, np.exp(stripes), **of), contrast)
    faded = intensity_contrast(near, stripes * (1.0 + 0.3 * ELEVATION), **of)
    assert np.corrcoef(faded, contrast)[0, 1] > 0.95
    bright = np.floor(np.degrees(AZIMUTH)) % 2 == 1
    assert contrast[bright].mean() > 0.5
    assert contrast[~bright].mean() < -0.5


def test_a_beam_without_intensity_has_no_contrast_and_spoils_no_other():
    intensity = np.random.default_rng(6).random(AZIMUTH.size)
    intensity[1000] = np.nan
    contrast = intensity_contrast(
        find_beam_neighbours(RAYS * 9.0), intensity, radius_rad=0.02, slope_max=10.0
    )
    assert np.flatnonzero(np.isnan(contrast)).tolist() == [1000]
