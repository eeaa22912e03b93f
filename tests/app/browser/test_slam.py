"""The Map panel's other mode: a run from the button to its map, two runs, and a failure."""

import zipfile
from collections.abc import Iterator
from pathlib import Path
from threading import Event
from typing import Any

import pytest
from playwright.sync_api import expect

from fusion_core.model.errors import MappingFailed
from scanloom.jobs import slam_run as job
from scanloom.server.workbench import Workbench
from scanloom.state.slam_choices import SlamChoices
from tests.app.browser.person import Person, decoded
from tests.app.slam_runs import SCANS, FakeMap
from tests.patience import ENOUGH_S

FIRST, SECOND = "1: lidar, recorded, pose-graph", "2: lidar, recorded, particle-filter (30)"


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeMap]:
    fake = FakeMap()
    monkeypatch.setattr(job, "build_map", fake)
    return fake


@pytest.fixture
def newcomer(person: Person, workbench: Workbench) -> Person:
    """The resident in the mode, after a reload, so that their runs begin anew."""
    person.look_at(person.session.view.changed(panel="Map", map_mode="SLAM"))
    person.reload(workbench)
    expect(person.button("Run")).to_be_enabled()
    return person


def finish(person: Person, name: str) -> None:
    """Wait until a run is shown and another may begin."""
    expect(person.page.get_by_label("Run shown", exact=True)).to_have_value(name)
    expect(person.button("Run")).to_be_enabled()
    expect(person.button("Cancel run")).to_have_count(0)


def test_a_run_moves_and_ends_on_its_map(newcomer: Person, fake: FakeMap) -> None:
    person = newcomer
    begun, go_on = Event(), Event()

    def wait(number: int) -> None:
        if number == SCANS // 2:
            begun.set()
            assert go_on.wait(ENOUGH_S), "nobody let it go on"

    fake.at_scan = wait
    person.press("Run")
    person.wait_until(begun.is_set)
    expect(person.text("Matching scans, ")).to_be_visible()
    assert person.figure().shape[1] == 480
    go_on.set()
    finish(person, FIRST)
    # The panel's picture is the file that the run wrote.
    written = (fake.calls[0][1] / "trajectory.png").read_bytes()
    person.wait_for_figure(decoded(written)[..., ::-1])
    expect(person.text("10 scans do not fit the map")).to_be_visible()
    with person.page.expect_download() as arriving:
        person.press("Download run (.zip)")
    with zipfile.ZipFile(arriving.value.path()) as archive:
        names = {Path(name).name for name in archive.namelist()}
    assert names == {
        "map_lidar.pgm",
        "map_lidar.yaml",
        "trajectory.png",
        "trajectory.tum",
        "graph.g2o",
        "report.json",
    }


@pytest.mark.slow
def test_two_runs_are_compared(newcomer: Person, fake: FakeMap) -> None:
    person = newcomer
    person.press("Run")
    finish(person, FIRST)
    fake.shift_m = 0.2
    person.choose("SLAM", "particle-filter")
    person.wait_until(lambda: person.session.view.slam.estimator == "particle-filter")
    person.press("Run")
    finish(person, SECOND)
    expect(person.text("10.0 cm in the median, at most 20.0 cm")).to_be_visible()
    # The file of the run, and both runs; its effective number, and how far they are apart.
    assert person.figure(1).shape[1] == 480
    for title in ("Effective number of particles", "Distance between A and B"):
        expect(person.text(title)).to_be_visible()
    person.choose("A", SECOND)
    expect(person.text("0.0 cm in the median, at most 0.0 cm")).to_be_visible()


@pytest.mark.slow
def test_after_a_failure_the_page_works_on(
    newcomer: Person, fake: FakeMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    person = newcomer

    def fail(*args: Any) -> Any:
        raise MappingFailed("there is no scan to place.", advice="Choose another scan.")

    monkeypatch.setattr(job, "build_map", fail)
    person.press("Run")
    expect(person.text("Failed: there is no scan to place. Choose another scan.")).to_be_visible()
    monkeypatch.setattr(job, "build_map", fake)
    person.press("Run")
    finish(person, "2: lidar, recorded, pose-graph")


def test_a_reload_restores_the_choices_and_forgets_the_runs(
    newcomer: Person, workbench: Workbench, fake: FakeMap
) -> None:
    person = newcomer
    person.press("Run")
    finish(person, FIRST)
    person.choose("Scan", "repaired")
    person.choose("SLAM", "particle-filter")
    chosen = SlamChoices(scan="repaired", estimator="particle-filter")
    person.wait_until(lambda: person.session.view.slam == chosen)
    folder = fake.calls[0][1].parent
    assert folder.exists()
    person.reload(workbench)
    assert person.session.view.slam == chosen
    for label, value in (("Mode", "SLAM"), ("Scan", "repaired"), ("SLAM", "particle-filter")):
        expect(person.page.get_by_label(label, exact=True)).to_have_value(value)
    assert person.thumb("Particles").get_attribute("aria-valuenow") == "30"
    expect(person.page.get_by_label("Run shown", exact=True)).to_have_count(0)
    person.wait_until(lambda: not folder.exists())
