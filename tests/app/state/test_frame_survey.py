"""The survey of a recording's frames: its counts, its order, who shares it and when it stops."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from fusion_core.model.classes import NoiseClass
from fusion_core.model.errors import AlignmentFailed, RecordingError
from fusion_core.workflows.fuse.cached_chain import CachedChain, FrameChoice
from scanloom.jobs.activity import Activity
from scanloom.jobs.long_job import Cancelled
from scanloom.state import frame_survey as survey_module
from scanloom.state import survey_runner as runner_module
from scanloom.state.frame_survey import (
    MAX_SAMPLED,
    FrameCounts,
    FrameStatus,
    FrameSurvey,
    SurveyInputs,
    pairs_by_class,
    visiting_order,
)
from scanloom.state.library import Library
from scanloom.state.open_recording import OpenRecording
from scanloom.state.survey_runner import SurveyRunner
from scanloom.state.view import View
from tests.patience import ENOUGH_S


@pytest.fixture(scope="module")
def opened(small_scene: Path) -> Iterator[OpenRecording]:
    library = Library([small_scene], [])
    open_recording = library.open(View(recording=small_scene.name), viewer="the tests")
    open_recording.align(lambda: None)
    assert open_recording.wait(ENOUGH_S)
    yield open_recording
    library.close()


@pytest.fixture
def inputs(opened: OpenRecording) -> SurveyInputs:
    assert opened.chain is not None
    return SurveyInputs(
        chain=opened.chain, settings=opened.fuse_session.settings, pairing=opened.pairing
    )


def finished(survey: FrameSurvey) -> FrameCounts:
    while survey.advance():
        pass
    return survey.counts


def with_epsilon(inputs: SurveyInputs, epsilon: float) -> SurveyInputs:
    noise = inputs.settings.noise.model_copy(update={"epsilon": epsilon})
    settings = inputs.settings.model_copy(update={"noise": noise})
    return SurveyInputs(chain=inputs.chain, settings=settings, pairing=inputs.pairing)


# Counting


def test_the_counts_are_those_of_the_chain(inputs: SurveyInputs) -> None:
    counts = finished(FrameSurvey(inputs))
    assert counts.is_complete
    assert not counts.is_sampled
    for number in (0, 5, len(inputs.chain.frames) - 1):
        fused = inputs.chain.fused(FrameChoice(number=number), inputs.settings)
        worse = [
            max(pair)
            for pair in zip(
                fused.classes.lidar_class.tolist(), fused.classes.depth_class.tolist(), strict=True
            )
        ]
        expected = [worse.count(kind) for kind in NoiseClass]
        assert counts.counts[number].tolist() == expected == pairs_by_class(fused).tolist()
        assert counts.status[number] == FrameStatus.COUNTED


def test_what_is_not_counted_yet_is_unknown_and_not_zero(inputs: SurveyInputs) -> None:
    survey = FrameSurvey(inputs)
    assert np.isnan(survey.counts.counts).all()
    assert np.isnan(survey.counts.noise_share).all()
    assert survey.advance()
    counts = survey.counts
    assert (counts.done, counts.total) == (1, len(inputs.chain.frames))
    assert np.isfinite(counts.counts).all(axis=1).sum() == 1
    assert (counts.status == FrameStatus.UNKNOWN).sum() == counts.total - 1


def test_a_survey_keeps_no_frame(inputs: SurveyInputs) -> None:
    own = with_epsilon(inputs, 3.3)
    before = len(own.chain._fused), len(own.chain._matches)
    finished(FrameSurvey(own))
    assert (len(own.chain._fused), len(own.chain._matches)) == before


def test_frames_that_fail_are_told_apart(
    inputs: SurveyInputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    own_match, own_pair = CachedChain.match_once, inputs.chain.frames.pair

    def match(chain: CachedChain, choice: FrameChoice, settings: object) -> object:
        if choice.number == 1:
            raise AlignmentFailed("no peak.")
        if choice.number == 2:
            raise ZeroDivisionError
        return own_match(chain, choice, settings)  # type: ignore[arg-type]  # as it was called

    def pair(number: int, clock_offset_ms: float = 0.0) -> object:
        if number == 3:
            raise RecordingError("damaged.")
        return own_pair(number, clock_offset_ms)

    monkeypatch.setattr(CachedChain, "match_once", match)
    monkeypatch.setattr(inputs.chain.frames, "pair", pair)
    counts = finished(FrameSurvey(inputs))
    assert counts.status[:5].tolist() == [
        FrameStatus.COUNTED,
        FrameStatus.UNMATCHED,
        FrameStatus.UNMATCHED,
        FrameStatus.UNREADABLE,
        FrameStatus.COUNTED,
    ]
    assert np.isnan(counts.counts[1:4]).all()


def test_frames_without_a_scan_are_known_from_the_stamps(inputs: SurveyInputs) -> None:
    time = inputs.settings.time.model_copy(update={"max_gap_ms": 0.001})
    settings = inputs.settings.model_copy(update={"time": time})
    survey = FrameSurvey(
        SurveyInputs(chain=inputs.chain, settings=settings, pairing=inputs.pairing)
    )
    assert inputs.pairing is not None
    paired = inputs.pairing.gaps(0.0, time).is_paired
    assert (survey.counts.status == FrameStatus.NO_SCAN).sum() == (~paired).sum() > 0


def test_an_offset_of_its_own_is_trusted_only_where_it_is_the_best_one(
    inputs: SurveyInputs,
) -> None:
    # Frame by frame the pairs rest on (u, v): around the recording's u, and far from any other.
    search = inputs.settings.search.model_copy(update={"use_prior": True})
    settings = inputs.settings.model_copy(update={"pairing": "frame", "search": search})
    chain = inputs.chain
    trusted = []
    for number in range(len(chain.frames)):
        match = chain.match_once(FrameChoice(number=number), settings)
        peak = match.search.peaks[search.metric]
        alone = match.search.peaks_without_prior[search.metric]
        found = survey_module.is_offset_trusted(match, settings)
        if match.row_model != "curve":
            assert found == (abs(peak.u - alone.u) <= search.prior_samples)
        trusted.append(found)
    assert any(trusted)


def test_a_frame_that_somebody_looks_at_is_counted_with_it(inputs: SurveyInputs) -> None:
    survey = FrameSurvey(inputs)
    last = len(inputs.chain.frames) - 1
    survey.note(last, inputs.chain.fused(FrameChoice(number=last), inputs.settings))
    assert survey.counts.status[last] == FrameStatus.COUNTED
    assert survey.counts.done == 0


# The order


@pytest.mark.parametrize("frames", [0, 1, 2, 7, 120, 2000])
def test_every_frame_of_a_short_recording_is_visited_once(frames: int) -> None:
    assert sorted(visiting_order(frames).tolist()) == list(range(frames))


@pytest.mark.parametrize("cameras", [1, 2, 4])
def test_a_long_recording_is_sampled_evenly_and_from_every_camera(cameras: int) -> None:
    order = visiting_order(100_000, cameras)
    numbers = np.sort(order)
    assert 0.99 * MAX_SAMPLED <= numbers.size <= MAX_SAMPLED
    assert np.unique(numbers).size == numbers.size
    assert numbers[0] <= 100
    assert numbers[-1] >= 99_900
    assert np.diff(numbers).max() <= 2 * 100_000 / MAX_SAMPLED
    per_camera = np.bincount(numbers % cameras, minlength=cameras)
    assert per_camera.min() > 0.5 * numbers.size / cameras


@pytest.mark.parametrize("frames", [100, 1000])
def test_any_beginning_of_the_order_is_spread_over_the_recording(frames: int) -> None:
    order = visiting_order(frames)
    for begun in (8, 16, 32, 64):
        gaps = np.diff(np.concatenate([[0], np.sort(order[:begun]), [frames]]))
        assert gaps.max() <= 3.0 * frames / begun


# Worst frame and conflicts


def counts_of(rows: list[tuple[float, float, float, float] | None]) -> FrameCounts:
    values = np.array([(np.nan,) * 4 if row is None else row for row in rows], np.float32)
    status = np.array([FrameStatus.UNKNOWN if r is None else FrameStatus.COUNTED for r in rows])
    return FrameCounts(counts=values, status=status, done=len(rows), total=len(rows))


def test_the_worst_frame_has_the_largest_share_of_enough_pairs() -> None:
    counts = counts_of([(90, 5, 5, 0), None, (0, 5, 0, 0), (50, 20, 20, 10), (40, 60, 0, 0)])
    assert counts.worst_frame() == 4
    assert counts_of([(90, 0, 0, 0), None, (1, 5, 5, 5)]).worst_frame() is None
    assert counts_of([None]).worst_frame() is None


def test_conflicts_follow_each_other_around_the_recording() -> None:
    yes, no = (90.0, 0.0, 0.0, 9.0), (90.0, 0.0, 0.0, 2.0)
    #                   0   1    2    3     4    5   6
    counts = counts_of([no, yes, yes, None, yes, no, yes])
    assert [counts.next_conflict(at) for at in range(7)] == [1, 6, 6, 6, 6, 6, 1]
    assert [counts.next_conflict(at, -1) for at in range(7)] == [6, 6, 1, 1, 1, 1, 1]
    assert counts_of([no, no]).next_conflict(0) is None
    assert counts_of([no, yes]).next_conflict(1) is None


# Running


class Ran:
    """A runner with short times, and what it told."""

    def __init__(self) -> None:
        self.activity = Activity()
        self.runner = SurveyRunner(self.activity)
        self.told = threading.Semaphore(0)

    def want(self, viewer: str, inputs: SurveyInputs) -> FrameSurvey:
        return self.runner.want(viewer, inputs, self.told.release)

    def until(self, condition: Callable[[], bool]) -> None:
        """Looked at whenever the runner tells something."""
        while not condition():
            assert self.told.acquire(timeout=ENOUGH_S)


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> Iterator[Ran]:
    for name in ("_DEBOUNCE_S", "_QUIET_S", "_NOTIFY_S"):
        monkeypatch.setattr(runner_module, name, 0.0)
    made = Ran()
    yield made
    made.runner.close()
    assert made.runner.wait(ENOUGH_S)


def test_equal_settings_share_one_survey(inputs: SurveyInputs, ran: Ran) -> None:
    first, second = ran.want("a", inputs), ran.want("b", with_epsilon(inputs, 2.6))
    assert (first is second) == (inputs.settings.noise.epsilon == 2.6)
    assert ran.want("b", inputs) is first
    assert ran.runner.wait(ENOUGH_S)
    assert first.is_complete
    assert ran.told.acquire(timeout=ENOUGH_S)


def test_a_survey_that_nobody_wants_stops_and_is_continued(inputs: SurveyInputs, ran: Ran) -> None:
    own = with_epsilon(inputs, 1.7)
    survey = ran.want("a", own)
    ran.until(lambda: survey.done >= 2)
    ran.runner.release("a")
    assert ran.runner.wait(ENOUGH_S)
    done = survey.done
    assert not survey.is_complete
    assert ran.want("a", own) is survey
    assert survey.done >= done
    assert ran.runner.wait(ENOUGH_S)
    assert survey.is_complete


def test_other_settings_replace_a_viewers_survey(inputs: SurveyInputs, ran: Ran) -> None:
    first = ran.want("a", with_epsilon(inputs, 1.9))
    ran.until(lambda: first.done >= 1)
    second = ran.want("a", with_epsilon(inputs, 2.9))
    assert ran.runner.wait(ENOUGH_S)
    assert second.is_complete
    assert not first.is_complete


def test_settings_that_are_dragged_are_surveyed_when_they_rest(
    inputs: SurveyInputs, ran: Ran, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner_module, "_DEBOUNCE_S", 3600.0)
    first = ran.want("a", inputs)
    # The first one is no drag.
    assert ran.runner.wait(ENOUGH_S)
    assert first.is_complete
    dragged = [ran.want("a", with_epsilon(inputs, epsilon)) for epsilon in (3.1, 3.2, 3.4)]
    ran.runner.release("a")
    assert ran.runner.wait(ENOUGH_S)
    assert [survey.done for survey in dragged] == [0, 0, 0]


def test_it_waits_while_a_person_waits(inputs: SurveyInputs, ran: Ran) -> None:
    with ran.activity.working():
        survey = ran.want("a", with_epsilon(inputs, 4.4))
        assert not ran.runner.wait(0.3)
        assert survey.done == 0
    assert ran.runner.wait(ENOUGH_S)
    assert survey.is_complete


def test_it_goes_on_slowly_where_somebody_never_stops(
    inputs: SurveyInputs, ran: Ran, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner_module, "_LONGEST_WAIT_S", 0.0)
    monkeypatch.setattr(runner_module, "_LOOK_S", 0.001)
    with ran.activity.working():
        survey = ran.want("a", with_epsilon(inputs, 4.5))
        assert ran.runner.wait(ENOUGH_S)
    assert survey.is_complete


def test_a_closed_runner_does_nothing(inputs: SurveyInputs, ran: Ran) -> None:
    ran.runner.close()
    survey = ran.want("a", with_epsilon(inputs, 4.6))
    assert ran.runner.wait(ENOUGH_S)
    assert survey.done == 0


def test_a_cancelled_frame_stays_unknown(inputs: SurveyInputs) -> None:
    survey = FrameSurvey(inputs)

    def refuse() -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        survey.advance(refuse)
    assert survey.done == 0
    assert np.isnan(survey.counts.counts).all()


def test_former_surveys_are_kept_for_a_while_only(
    inputs: SurveyInputs, ran: Ran, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner_module, "_DEBOUNCE_S", 3600.0)
    kept = runner_module._SURVEYS_KEPT
    epsilons = [1.0 + 0.1 * step for step in range(2 * kept)]
    surveys = [ran.want("a", with_epsilon(inputs, epsilon)) for epsilon in epsilons]
    assert ran.want("a", with_epsilon(inputs, epsilons[-2])) is surveys[-2]
    assert ran.want("a", with_epsilon(inputs, epsilons[0])) is not surveys[0]


def test_large_former_surveys_are_kept_as_far_as_they_fit(
    inputs: SurveyInputs, ran: Ran, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner_module, "_DEBOUNCE_S", 3600.0)
    epsilons = [1.0, 1.1, 1.2]
    surveys = []
    for epsilon in epsilons:
        surveys.append(ran.want("a", with_epsilon(inputs, epsilon)))
        empty = surveys[-1].nbytes
        for _ in range(2):
            surveys[-1].advance()
    runs = [one for one in surveys[0].runs if one is not None]
    assert surveys[0].nbytes == empty + sum(one.nbytes for one in runs)
    assert sum(one.nbytes for one in runs) > 500
    # One beside the one that is wanted.
    fitting = surveys[1].nbytes + surveys[2].nbytes
    monkeypatch.setattr(runner_module, "_KEPT_BYTES", fitting)
    assert ran.want("a", with_epsilon(inputs, epsilons[2])) is surveys[2]
    assert ran.want("a", with_epsilon(inputs, epsilons[1])) is surveys[1]
    monkeypatch.setattr(runner_module, "_KEPT_BYTES", 0)
    assert ran.want("a", with_epsilon(inputs, epsilons[1])) is surveys[1]
    assert ran.want("a", with_epsilon(inputs, epsilons[0])) is not surveys[0]


def test_an_opened_recording_that_is_closed_ends_its_survey(small_scene: Path) -> None:
    library = Library([small_scene], [])
    open_recording = library.open(View(recording=small_scene.name), viewer="a")
    open_recording.align(lambda: None)
    assert open_recording.wait(ENOUGH_S)
    assert open_recording.chain is not None
    inputs = SurveyInputs(chain=open_recording.chain, settings=open_recording.fuse_session.settings)
    survey = open_recording.surveys.want("a", inputs, lambda: None)
    library.close()
    assert open_recording.surveys.wait(ENOUGH_S)
    assert not survey.is_complete
