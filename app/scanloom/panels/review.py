"""The Review panel: a person says of runs, of marked beams and of marked pixels what they are."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import viser

from fusion_core.model.classes import NoiseClass
from fusion_core.workflows.labels.open_store import checked_name
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView, survey_inputs
from scanloom.page.bridge import PageBridge
from scanloom.page.browser_storage import Answers, request_items
from scanloom.page.markup import paragraph
from scanloom.page.update_widget import update_widget
from scanloom.page_parts import Panel
from scanloom.panels.agreement import AgreementControls
from scanloom.panels.explanation import explain_beam_class, explain_pixel_class
from scanloom.panels.known_answers import KnownAnswersControls
from scanloom.panels.review_controls import ANSWERS, ReviewControls
from scanloom.panels.review_desk import ReviewDesk, ReviewState
from scanloom.panels.review_html import (
    PRESS_ACTION,
    PRESS_ANSWER,
    ProgressText,
    RunText,
    answers_html,
    progress_html,
    run_html,
)
from scanloom.panels.suggestions import SuggestionControls
from scanloom.panels.widgets.controls import Controls
from scanloom.panels.widgets.panel_job import PanelJob
from scanloom.scene.frame_summary import facts_of_beam
from scanloom.state.frame_runs import SENSORS, class_name
from scanloom.state.frame_survey import FrameSurvey
from scanloom.state.open_recording import OpenRecording

STORED_ANNOTATOR = "annotator"
# viser's page sends texts every 50 ms; a slow network may take longer.
_TYPED_WITHIN_S = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class _Folders:
    """What stands below the answers."""

    controls: ReviewControls
    agreement: AgreementControls
    suggestions: SuggestionControls


class ReviewPanel(Panel):
    """Begin with a name; then the queue, the run that is asked about, and the answers."""

    def __init__(
        self, client: viser.ClientHandle, bridge: PageBridge, session: ClientSession
    ) -> None:
        gui = client.gui
        self._client, self._session = client, session
        self._lock = threading.RLock()
        self._desk = ReviewDesk(session)
        session.review = self._desk
        self._opened: OpenRecording | None = None
        self._survey: FrameSurvey | None = None
        self._name = gui.add_text("Your name", "", hint="Your labels are a layer of this name")
        self._layer_name = gui.add_text(
            "Layer",
            "",
            hint="Where your labels go: empty for a layer of your name; another, such as "
            "adjudicated, for decisions on what several people have said",
        )
        self._begin = gui.add_button("Begin the review")
        self._job = PanelJob(gui, session, self._lock, lambda _: None)
        self._known_answers = KnownAnswersControls(gui, session, self._desk, self._job)
        self._progress = gui.add_html("", visible=False)
        self._run = gui.add_html("", visible=False)
        self._answers = gui.add_html("", visible=False)
        self._controls = Controls(gui, session)
        self._choices = gui.add_folder(None, visible=False)
        # The page opens the sooner for what is built when somebody reviews.
        self._folders: _Folders | None = None
        self._gui, self._bridge = gui, bridge
        self._begin.on_click(lambda _: self._start())
        bridge.on_press(PRESS_ANSWER, self._answer)
        actions: dict[str, Callable[[], None]] = {
            "next": lambda: self._desk.go(1),
            "previous": lambda: self._desk.go(-1),
            "split": self._desk.split,
            "unmark": self._desk.clear_selection,
        }
        bridge.on_press(PRESS_ACTION, lambda name: actions.get(name, _do_nothing)())
        self._add_keys(bridge, actions)
        request_items(client, (STORED_ANNOTATOR,), self._take_name)

    def show(self, frame_view: FrameView) -> None:
        """Show the run that is asked about, while the step is open."""
        view = frame_view.view
        self._controls.show(view)
        opened = frame_view.open_recording
        if self._opened is not None and self._opened.recording.path != opened.recording.path:
            self._desk.end()
            self._known_answers.forget()
            if self._folders is not None:
                self._folders.suggestions.forget()
        if self._opened is not opened:
            self._forget_survey()
            self._opened = opened
        if view.panel != "Review":
            self._forget_survey()
            return
        self._want_survey(frame_view)
        self._desk.follow(frame_view, self._survey)
        has_begun = self._desk.labels is not None
        for before in (self._name, self._layer_name, self._begin):
            update_widget(before, visible=not has_begun)
        for after in (self._progress, self._run, self._answers, self._choices):
            update_widget(after, visible=has_begun)
        if has_begun:
            self._show_folders(frame_view)
            self._show_state(frame_view, self._desk.state())

    def close(self) -> None:
        """Hear of no more labels."""
        self._job.close()
        if self._folders is not None:
            self._folders.agreement.close()
            self._folders.suggestions.close()
        self._desk.close()
        self._forget_survey()

    # Beginning

    def _take_name(self, answers: Answers) -> None:
        known = answers[STORED_ANNOTATOR]
        if known is not None and not self._name.value:
            update_widget(self._name, value=known[:80])

    def _start(self) -> None:
        opened = self._opened
        if opened is None:
            return
        # viser sends what is typed a little later than a press.
        time.sleep(_TYPED_WITHIN_S)
        try:
            name = checked_name(self._name.value, "an annotator")
            layer = checked_name(self._layer_name.value.strip() or name, "a layer")
            labels = self._session.library.labels(opened.recording.path)
        except Exception as error:  # noqa: BLE001  # told to the person
            self._session.show_failure(error, until_dismissed=True)
            return
        self._client.local_storage.set_item(STORED_ANNOTATOR, name)
        self._known_answers.forget()
        self._job.begin(
            "labels",
            lambda progress: self._desk.begin(labels, name, layer, progress),
            lambda _: self._job.end(),
        )

    def _leave(self) -> None:
        self._desk.end()
        self._session.refresh()

    # Showing

    def _show_folders(self, frame_view: FrameView) -> None:
        if self._folders is None:
            gui, bridge, session = self._gui, self._bridge, self._session
            with self._choices:
                controls = ReviewControls(gui, session, self._desk, self._controls)
                self._known_answers.add_folder(gui, self._controls)
                self._folders = _Folders(
                    controls=controls,
                    agreement=AgreementControls(gui, session, self._desk, self._lock),
                    suggestions=SuggestionControls(gui, bridge, session, self._desk, self._lock),
                )
                leave = gui.add_button("End this review", color="gray")
            leave.on_click(lambda _: self._leave())
        self._folders.controls.show()
        self._known_answers.show(frame_view.view)
        self._folders.agreement.show()
        self._folders.suggestions.show(frame_view)

    def _want_survey(self, frame_view: FrameView) -> None:
        inputs = survey_inputs(frame_view)
        if inputs is not None:
            surveys = frame_view.open_recording.surveys
            self._survey = surveys.want(self, inputs, self._session.refresh)

    def _forget_survey(self) -> None:
        if self._opened is not None and self._survey is not None:
            self._opened.surveys.release(self)
        self._survey = None

    def _show_state(self, frame_view: FrameView, state: ReviewState) -> None:
        view = frame_view.view
        progress = ProgressText(
            done=state.progress.done,
            total=state.progress.total,
            counted=state.counted[0],
            frames=state.counted[1],
            a_minute=state.a_minute,
            layer=self._desk.layer,
        )
        update_widget(self._progress, content=progress_html(progress))
        text = self._run_text(frame_view, state)
        content = paragraph(_nothing_asked(state)) if text is None else run_html(text)
        update_widget(self._run, content=content)
        is_marked = any(state.selected)
        update_widget(
            self._answers,
            content=answers_html(
                is_marked=is_marked, selected=state.selected, is_blind=view.review.blind
            ),
        )

    def _run_text(self, frame_view: FrameView, state: ReviewState) -> RunText | None:
        table, number = state.table, state.number
        if table is None or number is None:
            return None
        runs, run = table.runs(number)
        sensor = SENSORS[runs.sensor[run]]
        beams = runs.beam[state.part]
        is_blind = frame_view.view.review.blind
        return RunText(
            sensor=sensor,
            first=int(beams.min()),
            last=int(beams.max()),
            samples=beams.size,
            frame_index=int(table.frame[number]),
            noise_class=None if is_blind else int(runs.noise_class[run]),
            confidence=float(runs.confidence[run]),
            why=self._why(frame_view, sensor, int(beams[beams.size // 2])),
            elsewhere={} if is_blind else table.judged_elsewhere(number),
            labelled=self._desk.label_of_run(number),
            others={} if is_blind else self._desk.labels_of_others(number),
        )

    def _why(self, frame_view: FrameView, sensor: str, beam: int) -> list[str]:
        fused = frame_view.fused
        facts = None if fused is None else facts_of_beam(fused, beam)
        if facts is None:
            return []
        explain = explain_beam_class if sensor == "lidar" else explain_pixel_class
        return [explain(facts, frame_view.view.settings)]

    # Answers

    def _answer(self, name: str) -> None:
        if name in ANSWERS:
            self._desk.answer(ANSWERS[name])

    def _by_controls(self, act: Callable[[ReviewControls], None]) -> None:
        if self._folders is not None:
            act(self._folders.controls)

    def _add_keys(self, bridge: PageBridge, actions: dict[str, Callable[[], None]]) -> None:
        def in_review(act: Callable[[], None]) -> Callable[[], None]:
            return lambda: act() if self._desk.is_on else None

        keys: tuple[tuple[str, str, Callable[[], None]], ...] = (
            ("Review: yes, right", "Y", lambda: self._answer("accept")),
            ("Review: unsure", "U", lambda: self._answer("unsure")),
            *(
                (f"Review: {class_name(noise)}", str(noise + 1), _naming(self._answer, noise))
                for noise in NoiseClass
            ),
            ("Review: no label", "0", lambda: self._answer("clear")),
            ("Review: split the run", "X", actions["split"]),
            ("Review: unmark", "V", actions["unmark"]),
            (
                "Review: label run and neighbours",
                "I",
                lambda: self._by_controls(ReviewControls.answer_around),
            ),
            (
                "Review: point, box or brush",
                "B",
                lambda: self._by_controls(ReviewControls.next_tool),
            ),
        )
        for label, key, act in keys:
            bridge.add_key(label, key, in_review(act))


def _naming(answer: Callable[[str], None], noise: NoiseClass) -> Callable[[], None]:
    return lambda: answer(class_name(noise))


def _nothing_asked(state: ReviewState) -> str:
    if state.table is None:
        return "The frames are not counted yet."
    if state.progress.total and state.progress.done == state.progress.total:
        return "All runs of this queue are labelled."
    return "J begins with the first run; a click on a beam or a pixel asks about its run."


def _do_nothing() -> None:
    """A button that is not known, as from an older page."""
