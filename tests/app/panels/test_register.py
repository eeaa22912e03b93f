"""The Register panel: A and draws in words, epsilon in its units, and what the widgets change."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import viser

from fusion_core.denoising.noise_scale import NoiseScale
from fusion_core.model.errors import AlignmentFailed
from fusion_core.registration.ransac import PUBLISHED, RegistrationSettings, register
from fusion_core.workflows.fuse.epsilon import EpsilonInFrame
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.registration_details import (
    consensus_probabilities,
    decompose_registration,
    draw_at,
    planar_pairs,
    residual_curve,
)
from scanloom.panels import registration_text
from scanloom.panels.epsilon import EpsilonControls
from scanloom.panels.register import RegisterPanel
from scanloom.panels.residual_plot import ResidualPlot
from scanloom.plots.line_plot import css
from scanloom.plots.theme import DARK, LIGHT
from scanloom.scene.verdict import verdict_of
from scanloom.state.view import View

SIGMA_M = 0.04
ALIGNMENT = SimpleNamespace(scale=NoiseScale(floor_m=SIGMA_M, fraction=0.0))
# No truth stands beside it.
RECORDING = SimpleNamespace(path=Path("no such recording.mcap"))
OPENED = SimpleNamespace(recording=RECORDING, recalls={}, opened=SimpleNamespace(why_not_fused=""))
AZIMUTHS_RAD = np.linspace(0.5, -0.5, 60)
LIDAR_M = np.stack([-np.linspace(-1.5, 1.5, 60), 2.0 + 0.4 * np.linspace(-1.5, 1.5, 60) ** 2], 1)


def moved(points_m, *, turn_deg=0.0, scale=1.0, shift_m=(0.0, 0.0)):
    """Points turned to the left about the origin, scaled and shifted."""
    angle = np.deg2rad(turn_deg)
    x, z = points_m.T
    turned = np.stack(
        [x * np.cos(angle) - z * np.sin(angle), x * np.sin(angle) + z * np.cos(angle)], axis=1
    )
    return scale * turned + shift_m


def registered(depth_m, model="rigid", **values):
    settings = RegistrationSettings(model=model, stopping="fixed", draws=20, **values)
    return register(LIDAR_M, depth_m, settings)


def words_of(found):
    return registration_text.transform_text(found, decompose_registration(found))


def test_a_turn_and_a_shift_as_text():
    said = words_of(registered(moved(LIDAR_M, turn_deg=3.0, shift_m=(0.10, -0.05))))
    assert "rotates the LiDAR's points by **3.0° to the left**" in said
    assert "translates the origin by **10.0 cm to the right and 5.0 cm back**" in said
    assert "scales" not in said
    other = words_of(registered(moved(LIDAR_M, turn_deg=-3.0, shift_m=(-0.10, 0.05))))
    assert "**3.0° to the right**" in other
    assert "**10.0 cm to the left and 5.0 cm ahead**" in other


def test_a_scale_as_text():
    said = words_of(registered(moved(LIDAR_M, scale=1.02), model="similarity"))
    assert "scales by **1.020**: distances become 2.0 % longer" in said
    assert "rotates the LiDAR's points by **0.0°**" in said


def test_stretch_and_shear_as_text():
    sheared = LIDAR_M @ np.array([[1.1, 0.0], [0.1, 1.0]])
    said = words_of(registered(sheared, model="affine"))
    assert "scales x by **1.100** and z by **1.005**" in said
    assert f"shears by **{np.rad2deg(np.arctan(0.1)):.1f}°**" in said
    assert "flattens" not in said


def test_a_flattening_transform_is_warned_of():
    flat = register(LIDAR_M, LIDAR_M * (1.0, 0.01) + (0.0, 2.0), PUBLISHED)
    said = words_of(flat)
    assert "**flattens**: one direction keeps 1.0 % of its length" in said
    assert "multiplies errors by up to 100" in said


def test_a_perspective_as_text():
    w = 1.0 + LIDAR_M @ (0.0, 0.02)
    found = registered(LIDAR_M / w[:, np.newaxis], model="homography", condition_max=1e5)
    assert "has a perspective: w′ grows by **" in words_of(found)
    # w' grows by 2 % of what it is at z = 0.
    middle_z_m = LIDAR_M[:, 1].mean()
    assert f"{2.0 / (1.0 + 0.02 * middle_z_m):+.2f} %** per metre ahead" in words_of(found)


def test_refused_models_are_named_with_their_reason():
    found = registered(LIDAR_M, model="auto", condition_max=3.0)
    assert found.rejected
    said = words_of(found)
    for refusal in found.rejected:
        assert f"- {refusal.model}: {refusal.reason}" in said


def test_a_draw_as_text():
    found = registered(moved(LIDAR_M, shift_m=(0.1, 0.0)))
    best = registration_text.draw_text(draw_at(found, found.best_draw), found)
    assert "★ **the best draw**" in best
    assert "its A agrees with **60** of 60 pairs (100 %) within 10.0 cm" in best
    other = draw_at(found, (found.best_draw + 1) % 20)
    said = registration_text.draw_text(other, found)
    assert "best" not in said
    assert f"Pairs {', '.join(map(str, other.pairs))}." in said


def test_a_draw_that_determines_nothing_says_so():
    found = registered(LIDAR_M)
    draw = SimpleNamespace(
        index=3, pairs=np.array([1, 2]), A=np.full((3, 3), np.nan), inliers=0, is_inlier=None
    )
    assert "its pairs do not determine a transform" in registration_text.draw_text(draw, found)


def test_the_number_of_draws_is_explained():
    said = registration_text.consensus_text(
        registered(LIDAR_M), consensus_probabilities(registered(LIDAR_M))
    )
    assert said.startswith("100 % of the pairs are inliers (c), so a draw of n = 6")


def epsilon_said(middle_m, E_m=0.05, unit="sigma", epsilon=2.6):
    said = EpsilonInFrame(
        median_m=middle_m, min_m=middle_m, max_m=middle_m, beyond=3, compared=40, E_m=E_m
    )
    return registration_text.epsilon_text(said, epsilon, unit)


@pytest.mark.parametrize(
    ("middle_m", "where"),
    [(0.049, "below"), (0.05, "inside"), (0.0707, "inside"), (0.072, "above")],
)
def test_the_papers_band_as_text(middle_m, where):
    said = epsilon_said(middle_m)
    assert "The paper's band [E, √2 E] is [5.0, 7.1] cm here" in said
    assert f"ε lies **{where}** it" in said
    assert f"ε = **{100.0 * middle_m:.1f} cm** = 2.6 σ; **3** of 40 pairs disagree by more." in said


def test_epsilon_without_an_E_as_text():
    assert "the paper's band [E, √2 E] is not known" in epsilon_said(0.1, float("nan"))
    assert "ε in multiples of E has no value" in epsilon_said(float("nan"), float("nan"), "E", 1.2)


class RecordingSession:
    """A session that shows nothing and remembers its view."""

    def __init__(self) -> None:
        self.view = View(recording="a room", panel="Register")

    def change(self, **values) -> None:
        self.view = self.view.changed(**values)

    def change_setting(self, stage, name, value) -> None:
        self.view = self.view.with_setting(stage, name, value)


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


@pytest.fixture
def session() -> RecordingSession:
    return RecordingSession()


def frame_of(found, *, residual_m=None, epsilon_m=0.1, refusal=""):
    """A fused frame around a registration."""
    count = AZIMUTHS_RAD.size
    residual_m = np.zeros(count) if residual_m is None else residual_m
    pairs = SimpleNamespace(
        azimuth_rad=AZIMUTHS_RAD,
        residual_m=residual_m,
        lidar_range_m=np.hypot(*LIDAR_M.T),
        depth_as_range_m=np.hypot(*LIDAR_M.T),
    )
    good = np.zeros(count, dtype=np.int64)
    classes = SimpleNamespace(
        lidar_class=good, depth_class=good, epsilon_m=np.full(count, epsilon_m)
    )
    match = SimpleNamespace(registration=found, refusal=refusal, correspondence=pairs)
    return FusedFrame(match=match, classes=classes, repair=None, camera_range_m=None)


def frame_view(session, frame, failure=None, is_dark=False):
    chain = SimpleNamespace(alignment=ALIGNMENT)
    return SimpleNamespace(
        view=session.view,
        open_recording=OPENED,
        chain=chain,
        match=None if frame is None else frame.match,
        fused=frame,
        failure=failure,
        is_dark=is_dark,
    )


@pytest.fixture
def panel(server, session) -> RegisterPanel:
    return RegisterPanel(server.gui, session)


def test_the_panel_shows_a_frame(panel, session):
    found = registered(moved(LIDAR_M, turn_deg=2.0))
    panel.show(frame_view(session, frame_of(found)))
    assert panel._draw.max == 19
    assert "2.0° to the left" in panel._summary.content
    assert panel._pairs.image.min() < 255
    assert "Draw **0** of 0…19" in panel._draw_text.content


@pytest.mark.parametrize(
    ("error_m", "said"), [(0.0137, "differ by 1.4 cm in the mean"), (np.inf, "no mean difference")]
)
def test_the_verdict_tells_the_error_that_is_left(session, error_m, said):
    found = replace(registered(LIDAR_M), mean_error_m=error_m)
    session.change(panel="Register")
    verdict = verdict_of(frame_view(session, frame_of(found)))
    assert verdict.sentence == "60 of 60 pairs of beam and pixel agree on one transform"
    assert said in verdict.detail
    assert "inf" not in verdict.detail.replace("infinity", "")


def test_epsilon_alone_redraws_no_pairs(panel, session):
    found = registered(moved(LIDAR_M, turn_deg=2.0))
    frame = frame_of(found)
    panel.show(frame_view(session, frame))
    pairs, draw, data = panel._pairs.image, panel._draw_picture.image, panel._residuals._plot.data
    again = frame_of(found, epsilon_m=0.2)
    again.match.correspondence = frame.match.correspondence
    panel.show(frame_view(session, again))
    assert panel._pairs.image is pairs
    assert panel._draw_picture.image is draw
    assert panel._residuals._plot.data[-1][0] == -200.0 != data[-1][0]


def test_on_a_dark_page_pictures_and_plot_are_dark(panel, session):
    frame = frame_of(registered(moved(LIDAR_M, turn_deg=2.0)))
    for is_dark, theme in ((True, DARK), (False, LIGHT)):
        panel.show(frame_view(session, frame, is_dark=is_dark))
        for picture in (panel._pairs, panel._draw_picture):
            assert tuple(picture.image[3, 3]) == theme.background
        strokes = {axis.get("stroke") for axis in panel._residuals._plot.axes}
        assert strokes == ({css(DARK.ink)} if is_dark else {None})


def test_a_closed_panel_draws_nothing(panel, session):
    session.change(panel="Repair")
    panel.show(frame_view(session, frame_of(registered(LIDAR_M))))
    assert panel._pairs.image.min() == 255
    session.change(panel="Register")
    panel.show(frame_view(session, frame_of(registered(LIDAR_M))))
    assert panel._pairs.image.min() < 255


def test_a_draw_beyond_the_last_shows_the_last(panel, session):
    session.change(draw_index=500)
    panel.show(frame_view(session, frame_of(registered(LIDAR_M))))
    assert panel._draw.value == 19
    assert "Draw **19**" in panel._draw_text.content


def test_the_buttons_go_from_draw_to_draw(panel, session):
    found = registered(moved(LIDAR_M, shift_m=(0.3, 0.0)) + np.sin(LIDAR_M * 50.0) * 0.09)
    panel.show(frame_view(session, frame_of(found)))
    panel._go("Previous")
    assert session.view.draw_index == 0
    panel._go("Next")
    assert session.view.draw_index == 1
    panel._go("Best")
    assert session.view.draw_index == found.best_draw
    session.change(draw_index=19)
    panel._go("Next")
    assert session.view.draw_index == 19


def test_a_frame_without_a_map_says_why_and_shows_its_points(panel, session):
    panel.show(frame_view(session, frame_of(registered(LIDAR_M))))
    panel.show(frame_view(session, frame_of(None, refusal="no map fits the 60 valid of 60 pairs.")))
    assert "no map fits the 60 valid of 60 pairs." in panel._summary.content
    assert panel._pairs.visible
    assert panel._pairs.image.min() < 255
    assert not panel._draw.visible
    panel._go("Next")
    assert session.view.draw_index == 0


def test_a_frame_that_failed_gives_its_reason_and_then_the_old_frame_comes_back(panel, session):
    frame = frame_of(registered(LIDAR_M))
    panel.show(frame_view(session, frame))
    before = panel._summary.content
    panel.show(frame_view(session, None, AlignmentFailed("no scan lies near.")))
    assert "no scan lies near" in panel._summary.content
    assert panel._epsilon._text.content == ""
    assert not panel._pairs.visible
    panel.show(frame_view(session, frame))
    assert panel._summary.content == before
    assert panel._pairs.visible


def test_another_unit_has_about_the_same_length(server, session):
    controls = EpsilonControls(server.gui, session)
    found = registered(moved(LIDAR_M, shift_m=(0.1, 0.0)) + np.sin(LIDAR_M * 50.0) * 0.05)
    controls.show(frame_view(session, frame_of(found)))
    lengths_m = {"sigma": SIGMA_M, "E": found.mean_error_m, "m": 1.0}
    before_m = 2.6 * SIGMA_M
    for unit in ("E", "m", "sigma"):
        controls._change_unit(unit)
        noise = session.view.settings.noise
        assert noise.epsilon_unit == unit
        assert noise.epsilon * lengths_m[unit] == pytest.approx(before_m, rel=0.03)
    assert session.view.settings.noise.epsilon == pytest.approx(2.6)


def test_only_the_units_slider_is_seen(server, session):
    controls = EpsilonControls(server.gui, session)
    session.change_setting("noise", "epsilon_unit", "E")
    session.change_setting("noise", "epsilon", 1.3)
    controls.show(frame_view(session, frame_of(registered(LIDAR_M))))
    seen = [unit for unit, slider in controls._sliders._sliders.items() if slider.visible]
    assert seen == ["E"]
    assert controls._sliders._sliders["E"].value == 1.3


def test_a_value_of_the_unit_before_is_not_taken_for_one_of_the_next(server, session):
    controls = EpsilonControls(server.gui, session)
    late = controls._sliders._sliders["sigma"]
    session.change_setting("noise", "epsilon_unit", "m")
    session.change_setting("noise", "epsilon", 0.1)
    late._impl.value = 4.0
    moved = SimpleNamespace(client="a browser", target=late)
    for callback in late._impl.update_cb:
        callback(moved)
    assert (session.view.settings.noise.epsilon, session.view.settings.noise.epsilon_unit) == (
        0.1,
        "m",
    )
    session.change_setting("noise", "epsilon_unit", "sigma")
    for callback in late._impl.update_cb:
        callback(moved)
    assert session.view.settings.noise.epsilon == 4.0


def test_what_another_unit_cannot_hold_ends_at_its_slider(server, session):
    controls = EpsilonControls(server.gui, session)
    session.change_setting("noise", "epsilon", 90.0)
    controls.show(
        frame_view(session, frame_of(registered(LIDAR_M + np.sin(LIDAR_M * 50.0) * 0.002)))
    )
    assert controls._sliders._sliders["sigma"].value == 10.0
    assert session.view.settings.noise.epsilon == 90.0
    controls._change_unit("E")
    assert session.view.settings.noise.epsilon == 5.0


def test_residuals_beyond_the_plot_are_at_its_edge(server):
    plot = ResidualPlot(server.gui)
    residual_m = np.zeros(60)
    residual_m[[3, 5, 7]] = 0.2, -2.0, np.nan
    frame = frame_of(registered(LIDAR_M), residual_m=residual_m)
    plot.show(frame, signed=True)
    azimuth_deg, good, _, _, beyond, upper, lower = plot._plot.data
    assert (np.diff(azimuth_deg) > 0.0).all()
    assert azimuth_deg.size == residual_curve(frame).residual_mm.size == 59
    assert (np.nanmin(good), np.nanmax(good)) == pytest.approx((0.0, 200.0))
    assert beyond[np.isfinite(beyond)].tolist() == [-250.0]
    assert np.isfinite([upper, lower]).all()
    assert "1 beyond the plot at its edge, up to 2.00 m" in plot._text.content


def test_without_an_epsilon_the_plot_is_empty(server):
    plot = ResidualPlot(server.gui)
    plot.show(frame_of(registered(LIDAR_M), epsilon_m=float("nan")), signed=True)
    assert np.isnan(plot._plot.data[1]).all()
    assert not plot._plot.visible
    plot.show(frame_of(registered(LIDAR_M)), signed=True)
    assert plot._plot.visible
    plot.show(None, signed=True)
    assert not plot._plot.visible
    assert plot._text.content == ""


def test_the_panels_draws_are_those_of_the_registration(panel, session):
    found = registered(moved(LIDAR_M, turn_deg=1.0), refits_max=1)
    panel.show(frame_view(session, frame_of(found)))
    panel._go("Best")
    best = draw_at(found, session.view.draw_index)
    np.testing.assert_array_equal(best.is_inlier, planar_pairs(frame_of(found).match).inliers)
