"""What is held of a mount before the data, and how much of the data agrees with one."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.alignment.mount_cost import MountCost
from fusion_core.alignment.mount_settings import MountPriors
from tests.alignment.test_mount import SETTINGS, drive, random_mount

lengths = st.floats(-2.0, 2.0)
deviations = st.floats(0.01, 2.0)


@given(lengths, lengths, deviations, deviations)
def test_a_height_has_its_own_doubt_on_each_side(
    height_m: float, centre_m: float, below_m: float, above_m: float
) -> None:
    priors = MountPriors.without_recorded(0.3, SETTINGS).with_height(centre_m, below_m, above_m)
    values = np.array([[0.1, height_m, 0.2, -0.1, 0.05, 30.0], [0.0] * 6])
    expected = ((values - priors.centre) / priors.sd) ** 2
    for row, value in enumerate(values[:, 1]):
        own_sd = above_m if value > centre_m else below_m
        expected[row, 1] = ((value - centre_m) / own_sd) ** 2
    np.testing.assert_allclose(priors.squares(values), expected, rtol=1e-12)
    np.testing.assert_allclose(priors.squares(values[0]), expected[0], rtol=1e-12)


def test_heights_are_drawn_from_what_is_held_of_them() -> None:
    """Half of the draws on each side, each half as wide as its own deviation."""
    rng = np.random.default_rng(0)
    held = MountPriors.without_recorded(0.3, SETTINGS).with_height(0.4, 0.2, 1.0)
    drawn = np.array([held.with_drawn_height_and_pitch(rng).centre for _ in range(4000)])
    off = drawn - held.centre
    assert (off[:, [0, 2, 3, 5]] == 0.0).all()
    above = off[:, 1] > 0.0
    assert np.mean(above) == pytest.approx(0.5, abs=0.03)
    assert np.sqrt(np.mean(off[above, 1] ** 2)) == pytest.approx(1.0, rel=0.05)
    assert np.sqrt(np.mean(off[~above, 1] ** 2)) == pytest.approx(0.2, rel=0.05)
    assert np.std(off[:, 4]) == pytest.approx(held.sd[4], rel=0.05)


def test_what_may_be_hidden_counts_as_the_cost_of_occlusion(furnished_room) -> None:
    """Something stands before the right third of each image, which is no fault of the mount."""
    mount = random_mount(2)
    frames = drive(furnished_room, mount, 2, count=8)
    problem = MountCost(frames, SETTINGS)
    clear, _ = problem.agreement_and_visibility(mount.vector())
    hidden = []
    for frame in frames:
        depth_m = frame.depth_m.copy()
        depth_m[:, 2 * depth_m.shape[1] // 3 :] *= np.float32(0.5)
        hidden.append(replace(frame, depth_m=depth_m))
    behind = MountCost(hidden, SETTINGS)
    _, _, on_depth, agreeing, nearer = behind.tallies_per_frame(mount.vector()).sum(axis=0)
    assert nearer > 0.2 * on_depth
    beyond = on_depth - agreeing - nearer
    expected = agreeing / (agreeing + beyond + SETTINGS.occlusion_cost * nearer)
    found, _ = behind.agreement_and_visibility(mount.vector())
    assert found == pytest.approx(expected)
    assert agreeing / on_depth < found < clear
    # What is seen through contradicts the mount, all of it.
    farther = [replace(frame, depth_m=1.5 * frame.depth_m) for frame in frames]
    seen_through = MountCost(farther, SETTINGS)
    _, _, on_depth, agreeing, _ = seen_through.tallies_per_frame(mount.vector()).sum(axis=0)
    found, _ = seen_through.agreement_and_visibility(mount.vector())
    assert found == pytest.approx(agreeing / on_depth, abs=0.02)
