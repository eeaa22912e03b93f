"""The Repair panel on the sample, worked by a browser's messages: pictures, numbers and jumps."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
import viser

from fusion_core.model.classes import NoiseClass, RepairSource
from fusion_core.model.errors import ScanLoomError
from fusion_core.workflows.fuse.frame import FusedFrame
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView, compute_frame_view
from scanloom.panels.repair import RepairPanel
from scanloom.plots.palette import class_color, color_of
from scanloom.plots.theme import DARK, LIGHT
from scanloom.resources import sample_path
from scanloom.scene.frame_summary import (
    conflict_runs,
    counts_of_beams,
    counts_of_pixels,
    facts_of_beam,
)
from scanloom.scene.verdict import verdict_of
from scanloom.state.library import Library
from scanloom.state.view import View
from tests.app.viser_client import ViserClient, connect
from tests.patience import ENOUGH_S, comes_true

# A frame of the sample with several conflicts, and one of a different table.
FRAME, OTHER_FRAME = 58, 80
ALL = frozenset(NoiseClass)


@dataclass(frozen=True)
class Bench:
    """A browser at a session with nothing but this panel."""

    session: ClientSession
    panel: RepairPanel
    browser: ViserClient

    @property
    def frame_view(self) -> FrameView:
        open_recording = self.session._library.open(self.session.view)
        return compute_frame_view(self.session.view, open_recording)

    @property
    def frame(self) -> FusedFrame:
        fused = self.frame_view.fused
        assert fused is not None
        return fused

    def until(self, condition: Callable[[], bool]) -> None:
        """Wait for what a message of the browser brings about, and until that is shown."""
        assert comes_true(condition)
        assert self.session.wait(ENOUGH_S)

    def change(self, **values: object) -> None:
        self.session.change(**values)
        assert self.session.wait(ENOUGH_S)

    def html(self, *words: str) -> str:
        """The HTML that holds these words, as the browser has it."""
        self.browser.wait_until(lambda: len(self._htmls(words)) == 1)
        return self._htmls(words)[0]

    def _htmls(self, words: tuple[str, ...]) -> list[str]:
        known = [str(w.props.get("content", "")) for w in self.browser.widgets.values()]
        return [content for content in known if all(word in content for word in words)]


@pytest.fixture(scope="module")
def module_bench() -> Iterator[Bench]:
    library = Library([sample_path()], [])
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    built: list[tuple[ClientSession, RepairPanel]] = []

    @server.on_client_connect
    def _(client: viser.ClientHandle) -> None:
        view = View(recording=next(iter(library.named())), panel="Repair", frame_index=FRAME)
        session = ClientSession(client, library, view)
        panel = RepairPanel(client.gui, session)
        session.panels = [panel]
        session.refresh()
        built.append((session, panel))

    with connect(f"http://127.0.0.1:{server.get_port()}") as browser:
        browser.find("Conflicts")
        assert comes_true(lambda: bool(built) and library.open(built[0][0].view).chain is not None)
        yield Bench(*built[0], browser)
        built[0][0].close()
    server.stop()
    library.close()


@pytest.fixture
def bench(module_bench: Bench) -> Bench:
    """The bench as at the start."""
    fresh = View(recording=module_bench.session.view.recording)
    module_bench.change(
        panel="Repair",
        frame_index=FRAME,
        visible_classes=ALL,
        show_raw_and_repaired=True,
        show_repaired=True,
        selected_beam=None,
        settings=fresh.settings,
    )
    return module_bench


def colored(rgb: np.ndarray, noise: NoiseClass) -> int:
    """Pixels of a picture in the colour of a class, of good ones in that of the LiDAR's line, but
    for the legend's symbols."""
    color = color_of("lidar") if noise == NoiseClass.GOOD else class_color(noise)
    return int((rgb[:-60] == color).all(axis=2).sum())


def numbers(table: str, words: str) -> list[int]:
    """The numbers in the row of a table that has these words."""
    row = next(row for row in table.split("<tr>") if words in row)
    return [int(cell) for cell in re.findall(r">(\d+)</td>", row)]


@pytest.mark.parametrize("number", [FRAME, OTHER_FRAME])
def test_the_table_has_the_numbers_of_the_frame(bench: Bench, number: int) -> None:
    bench.change(frame_index=number)
    classes, repair = bench.frame.classes, bench.frame.repair
    good = int((classes.lidar_class == NoiseClass.GOOD).sum())
    table = bench.html("burrs", f">{good}<")
    for noise in NoiseClass:
        expected = [
            int((found == noise).sum()) for found in (classes.lidar_class, classes.depth_class)
        ]
        assert numbers(table, f"></span>{noise.name.lower()}<") == expected
    assert numbers(table, "outside the image") == [int((classes.depth_class < 0).sum())]
    for words, source in (
        ("from the other sensor", RepairSource.OTHER_SENSOR),
        ("from neighbours", RepairSource.NEIGHBOURS),
    ):
        expected = [int((s == source).sum()) for s in (repair.lidar_source, repair.depth_source)]
        assert numbers(table, words) == expected


def test_the_filter_takes_a_class_out_of_the_pictures(bench: Bench) -> None:
    before, after = bench.panel._pictures
    assert colored(after.image, NoiseClass.GOOD) > 200
    bench.browser.set_value("Show good", False)
    bench.until(lambda: bench.session.view.visible_classes == ALL - {NoiseClass.GOOD})
    for picture in (before, after):
        assert colored(picture.image, NoiseClass.GOOD) == 0
        assert colored(picture.image, NoiseClass.HOLE) > 0
    bench.browser.set_value("Show good", True)
    bench.until(lambda: bench.session.view.visible_classes == ALL)
    assert colored(after.image, NoiseClass.GOOD) > 200


def test_the_list_of_conflicts_jumps_to_each(bench: Bench) -> None:
    runs = conflict_runs(bench.frame)
    assert len(runs) >= 2
    choices = bench.browser.find("Conflicts").props
    bench.browser.wait_until(
        lambda: choices["options"][0] == f"{len(runs)} in this frame: choose one"
    )
    _, *options = choices["options"]
    for run, words in zip(runs, options, strict=True):
        assert f"{run.lidar_m:.2f} m" in words
        bench.browser.set_value("Conflicts", words)
        bench.until(lambda run=run: bench.session.view.selected_beam == run.middle)
        bench.html(f"beam {run.middle}, range", "Conflict: it disagrees")


def test_the_buttons_go_around_the_conflicts(bench: Bench) -> None:
    middles = [run.middle for run in conflict_runs(bench.frame)]
    step = bench.browser.find("Go to conflict").uuid

    def press(name: str) -> int | None:
        before = bench.session.view.selected_beam
        bench.browser.update(step, {"value": name})
        bench.until(lambda: bench.session.view.selected_beam != before)
        return bench.session.view.selected_beam

    assert [press("Next") for _ in range(len(middles) + 1)] == [*middles, middles[0]]
    assert press("Previous") == middles[-1]
    bench.change(selected_beam=None)
    assert press("Previous") == middles[-1]


def test_a_number_tells_of_that_beam(bench: Bench) -> None:
    holes = bench.frame.classes.lidar_class == NoiseClass.HOLE
    filled = np.flatnonzero(holes & np.isfinite(bench.frame.repair.lidar_range_m))
    beam = int(bench.frame.match.correspondence.beam[filled[0]])
    facts = facts_of_beam(bench.frame, beam)
    assert facts is not None
    bench.browser.set_value("Beam", str(beam))
    bench.until(lambda: bench.session.view.selected_beam == beam)
    table = bench.html(f"beam {beam}, range")
    assert f"{facts.lidar.repaired_m:.2f} m" in table
    assert "no value" in table
    assert f"{facts.lidar.confidence:.2f}" in table
    assert "Filled from" in table
    bench.browser.set_value("Beam", "")
    bench.until(lambda: bench.session.view.selected_beam is None)
    bench.html("Choose a conflict, type")


def test_beams_out_of_view_and_beams_that_are_none_are_reported(bench: Bench) -> None:
    bench.change(selected_beam=0)
    bench.html("Beam 0 lies outside the camera")
    bench.change(selected_beam=9999)
    bench.html("there is no beam 9999")


def test_before_and_after_are_drawn_only_where_they_are_wanted(bench: Bench) -> None:
    before, after = bench.panel._pictures
    assert (before.visible, after.visible) == (True, True)
    bench.browser.set_value("Before and after", False)
    bench.until(lambda: not bench.session.view.show_raw_and_repaired)
    assert (before.visible, after.visible) == (False, False)
    drawn = before.image, after.image
    bench.change(frame_index=OTHER_FRAME)
    assert before.image is drawn[0]
    assert after.image is drawn[1]
    # The rest goes on.
    bench.html("burrs", f">{(bench.frame.classes.lidar_class == NoiseClass.GOOD).sum()}<")
    bench.browser.set_value("Before and after", True)
    bench.until(lambda: bench.session.view.show_raw_and_repaired)
    assert (before.visible, after.visible) == (True, True)
    assert before.image is not drawn[0]


def test_what_the_repair_changed_differs_between_the_pictures(bench: Bench) -> None:
    # Without the marks on top of it.
    bench.change(visible_classes=frozenset())
    before, after = (picture.image for picture in bench.panel._pictures)
    assert before.shape == after.shape
    differing = (before[40:-80] != after[40:-80]).any(axis=2)
    assert 0 < differing.sum() < 0.02 * differing.size


def test_epsilon_has_one_slider_in_the_unit_of_the_settings(bench: Bench) -> None:
    sliders = bench.panel._epsilon._sliders
    assert [unit for unit, slider in sliders.items() if slider.visible] == ["sigma"]
    agreeing = (bench.frame.classes.lidar_class == NoiseClass.GOOD).sum()
    bench.browser.set_value("ε (σ)", 0.5)
    bench.until(lambda: bench.session.view.settings.noise.epsilon == 0.5)
    fewer = int((bench.frame.classes.lidar_class == NoiseClass.GOOD).sum())
    assert fewer < agreeing
    bench.html("burrs", f">{fewer}<")
    bench.session.change_setting("noise", "epsilon_unit", "m")
    bench.until(lambda: sliders["m"].visible)
    assert [unit for unit, slider in sliders.items() if slider.visible] == ["m"]


def test_a_box_takes_its_class_out_and_an_undone_view_brings_it_back(bench: Bench) -> None:
    bench.browser.set_value("Show burr", False)
    bench.until(lambda: bench.session.view.visible_classes == ALL - {NoiseClass.BURR})
    bench.browser.set_value("Show hole", False)
    bench.until(
        lambda: bench.session.view.visible_classes == {NoiseClass.GOOD, NoiseClass.CONFLICT}
    )
    bench.change(visible_classes=ALL)
    for name in ("burr", "hole"):
        box = bench.browser.find(f"Show {name}")
        bench.browser.wait_until(lambda: box.value is True)  # noqa: B023  # called at once


def test_while_another_panel_is_open_nothing_is_drawn(bench: Bench) -> None:
    drawn = bench.panel._pictures[1].image
    bench.change(panel="Map")
    bench.change(frame_index=OTHER_FRAME)
    assert bench.panel._pictures[1].image is drawn
    bench.change(panel="Repair")
    assert bench.panel._pictures[1].image is not drawn


def test_what_stays_the_same_is_not_drawn_again(bench: Bench) -> None:
    drawn = bench.panel._pictures[1].image
    bench.change(playback_speed=2.0)
    assert bench.panel._pictures[1].image is drawn
    bench.change(playback_speed=1.0)


def test_the_verdict_counts_as_agreeing_what_both_sensors_see(bench: Bench) -> None:
    """One count of each pair by hand: with no value on one side nothing can agree."""
    for number in (FRAME, OTHER_FRAME):
        bench.change(frame_index=number)
        verdict, frame = verdict_of(bench.frame_view), bench.frame
        pairs = frame.match.correspondence
        near = np.abs(pairs.residual_m) <= frame.classes.epsilon_m
        agreeing = missing = outside = 0
        for at, is_near in enumerate(near):
            good = frame.classes.lidar_class[at] == NoiseClass.GOOD
            has_pixel = pairs.row[at] >= 0
            agreeing += bool(good and is_near and frame.classes.depth_class[at] == NoiseClass.GOOD)
            missing += bool(np.isnan(pairs.lidar_range_m[at]) or np.isnan(pairs.depth_m[at]))
            outside += bool(good and not has_pixel)
        assert verdict.sentence == f"{agreeing} of {near.size} beams agree with the camera"
        assert verdict.counts is not None
        assert verdict.counts.without_pixel == outside
        assert verdict.counts.by_class[NoiseClass.HOLE] + outside <= missing
        beams, pixels = counts_of_beams(frame), counts_of_pixels(frame)
        for counts, what in ((beams, "ranges"), (pixels, "depths")):
            noise = counts.by_class[NoiseClass.HOLE] + counts.by_class[NoiseClass.BURR]
            kept = counts.by_source[RepairSource.RAW] + counts.by_source[RepairSource.NONE]
            assert f"{noise - kept} of {noise} {what}" in verdict.detail


def test_a_frame_that_failed_says_why_and_shows_nothing_of_another(bench: Bench) -> None:
    failure = ScanLoomError("no peak in <b>/scan</b>.", advice="Go on.")
    failed = replace(bench.frame_view, frame=None, failure=failure)
    bench.panel.show(failed)
    # Above the panel, once.
    assert verdict_of(failed).detail == "no peak in <b>/scan</b>. Go on."
    assert not any(handle.visible for handle in bench.panel._pictures)
    assert bench.panel._classes.content == ""
    assert bench.panel._conflicts.options == ("not known: the frame is not classified",)
    assert not bench.panel._step.visible
    bench.panel.show(bench.frame_view)
    assert bench.panel._step.visible
    assert all(handle.visible for handle in bench.panel._pictures)


def test_pictures_are_dark_on_a_dark_page(bench: Bench) -> None:
    bench.change(color_scheme="dark")
    for picture in bench.panel._pictures:
        assert tuple(picture.image[3, 3]) == DARK.background
    bench.change(color_scheme="light")
    for picture in bench.panel._pictures:
        assert tuple(picture.image[3, 3]) == LIGHT.background
