"""The Register panel: epsilon dragged, and the draws of RANSAC one by one."""

import numpy as np
from playwright.sync_api import expect

from fusion_core.model.classes import NoiseClass
from fusion_core.registration.ransac import Registration
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.registration_details import draw_at
from scanloom.plots.pair_plot import PairPlot, pair_picture
from tests.app.browser.expected_frame import NUMBER, expected_frame, repaired_picture
from tests.app.browser.person import Person, match_of

Counts = dict[str, tuple[int, int]]


def test_a_dragged_epsilon_classifies_every_pair_again(person: Person) -> None:
    view = person.session.view.changed(frame_index=NUMBER, panel="Repair")
    person.look_at(view.changed(show_raw_and_repaired=True))
    person.unfold("Classes, before and after")
    before = expected_frame(person.frame_view, person.session.view)
    person.wait_until(lambda: counts_on(person) == counts_of(before))
    frame_view = person.figure(1)
    person.wait_for_figure(repaired_picture(before, person.session.view, frame_view).rgb, 1)
    person.open_step("Register")
    person.wait_until(lambda: threshold_on(person) == threshold_in(before))
    epsilon = person.drag("ε (σ)", -25.0)
    person.wait_until(lambda: person.frame_view.view.settings.noise.epsilon == epsilon)
    expect(person.text(f"with noise.epsilon = {epsilon}")).to_be_visible()
    after = expected_frame(person.frame_view, person.session.view)
    assert threshold_in(after)[0] < threshold_in(before)[0]
    assert threshold_in(after)[1] > threshold_in(before)[1]
    person.wait_until(lambda: threshold_on(person) == threshold_in(after))
    assert counts_of(after) != counts_of(before)
    person.open_step("Repair")
    person.unfold("Classes, before and after")
    person.wait_until(lambda: counts_on(person) == counts_of(after))
    person.wait_for_figure(repaired_picture(after, person.session.view, frame_view).rgb, 1)


def threshold_in(frame: FusedFrame) -> tuple[float, int, int]:
    """Epsilon in cm, the pairs that disagree by more, and all that have both values."""
    residual_m, epsilon_m = frame.match.correspondence.residual_m, frame.classes.epsilon_m
    both = np.isfinite(residual_m)
    beyond = np.abs(residual_m[both]) > epsilon_m[both]
    return round(100.0 * float(np.median(epsilon_m[both])), 1), int(beyond.sum()), int(both.sum())


def threshold_on(person: Person) -> tuple[float, int, int]:
    """The same in the page's words."""
    pattern = r"ε = ([\d.]+) cm .*; (\d+) of (\d+) pairs disagree by more"
    length_cm, beyond, compared = person.read("pairs disagree by more", pattern)
    return float(length_cm), int(beyond), int(compared)


def counts_of(frame: FusedFrame) -> Counts:
    """Beams and pixels of each class."""
    codes = frame.classes.lidar_class, frame.classes.depth_class
    return {
        noise.name.lower(): (int((codes[0] == noise).sum()), int((codes[1] == noise).sum()))
        for noise in NoiseClass
    }


def counts_on(person: Person) -> Counts:
    """The same in the page's table."""
    rows = [row.split("\t") for row in person.page.locator("tr:visible").all_inner_texts()]
    named = {row[0].strip(): row[1:] for row in rows}
    names = [noise.name.lower() for noise in NoiseClass]
    return {name: (int(named[name][0]), int(named[name][1])) for name in names if name in named}


def test_each_draw_is_shown_as_it_was_drawn(person: Person) -> None:
    person.look_at(person.session.view.changed(frame_index=NUMBER, panel="Register"))
    found = match_of(person.frame_view, person.session.view).registration
    assert found is not None
    best = found.best_draw
    assert best > 2
    inliers = [int(agreeing(found, index).sum()) for index in range(len(found.draws))]
    assert inliers[best] == max(inliers)
    person.unfold("Draws, one by one")
    for button, index in (("", 0), ("Next", 1), ("Next", 2), ("Previous", 1), ("Best", best)):
        if button:
            person.press(button)
        wait_for_draw(person, index, inliers[index], found.valid)
        person.wait_for_figure(picture_of_draw(found, index, person.figure(1)), 1)
        expect(person.thumb("Draw")).to_have_attribute("aria-valuenow", str(index))
        assert person.text("★ the best draw").count() == (index == best)
    expect(person.text(f"A agrees with {int(found.inliers.sum())}.")).to_be_visible()


def agreeing(found: Registration, index: int) -> np.ndarray:
    """(m,) the pairs that agree with a draw's own transform, by its definition."""
    draws = found.draws
    mapped = np.column_stack([draws.lidar_points_m, np.ones(len(draws.lidar_points_m))])
    mapped = mapped @ draws[index].A
    away_m = np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - draws.depth_points_m, axis=1)
    agree: np.ndarray = away_m <= draws.inlier_threshold_m
    return agree


def wait_for_draw(person: Person, *numbers: int) -> None:
    """Wait until the page's words give number, inliers and valid pairs of a draw."""
    pattern = r"Draw (\d+) of .*: its A agrees with (\d+) of (\d+) pairs"
    said = tuple(map(str, numbers))
    person.wait_until(lambda: person.read("its A agrees with", pattern) == said)


def picture_of_draw(found: Registration, index: int, like: np.ndarray) -> np.ndarray:
    """(H, W, 3) RGB, of the size of another picture."""
    draw = draw_at(found, index)
    plot = PairPlot(
        title=f"Draw {index}: LiDAR through its own A, and depth",
        lidar_m=draw.mapped_m,
        depth_m=found.draws.depth_points_m,
        is_inlier=agreeing(found, index),
        sample=draw.pairs,
    )
    height_px, width_px = like.shape[:2]
    return pair_picture([plot], width_px=width_px, height_px=height_px).rgb
