"""Known answers among the runs of a review, and at its end how many of them the person gave."""

from typing import Any

import viser

from fusion_core.workflows.labels.score_layer import AnswerScore, score_layer
from scanloom.client_session import ClientSession
from scanloom.page.update_widget import update_widget
from scanloom.panels.label_tables import score_html
from scanloom.panels.review_desk import KnownAnswers, ReviewDesk
from scanloom.panels.widgets.controls import Controls
from scanloom.panels.widgets.panel_job import PanelJob
from scanloom.state.view import View

_NO_LAYER = "none"


class KnownAnswersControls:
    """A folder with what is hidden, a list of layers to take known answers from, and a button that
    ends the review; the score, which stands where this is made and stays then."""

    def __init__(
        self, gui: viser.GuiApi, session: ClientSession, desk: ReviewDesk, job: PanelJob
    ) -> None:
        self._session, self._desk, self._job = session, desk, job
        self._score = gui.add_html("", visible=False)

    def add_folder(self, gui: viser.GuiApi, controls: Controls) -> None:
        """Add a folder with what is hidden, the list and the button."""
        with gui.add_folder("Blind and known answers", expand_by_default=False):
            self._add_controls(gui, controls)

    def _add_controls(self, gui: viser.GuiApi, controls: Controls) -> None:
        blind = gui.add_checkbox(
            "Hide the automatic classes",
            self._session.view.review.blind,
            hint="So that they do not sway you; choose all classes in the queue, too",
        )
        controls.bind(
            blind, lambda view: view.review.blind, lambda is_blind: self._choose("blind", is_blind)
        )
        self._layers = gui.add_dropdown(
            "Known answers",
            (_NO_LAYER,),
            hint="A layer to be measured against. Runs that have its labels are in the queue like "
            "all others; its labels are not told before the end",
        )
        controls.bind(
            self._layers,
            lambda view: view.review.gold_layer or _NO_LAYER,
            lambda name: self._choose("gold_layer", "" if name == _NO_LAYER else name),
        )
        self._end = gui.add_button(
            "End and score",
            disabled=True,
            hint="End the review and tell how many of the known answers you gave",
        )
        self._end.on_click(lambda _: self._end_and_score())

    def show(self, view: View) -> None:
        """Offer the recording's layers."""
        own = self._desk.own
        others = () if own is None else own.others
        layers = dict.fromkeys([*others, view.review.gold_layer])
        update_widget(self._layers, options=(_NO_LAYER, *(name for name in layers if name)))
        update_widget(self._end, disabled=not self._desk.gold_layer)

    def forget(self) -> None:
        """Show no score: it is of another review."""
        update_widget(self._score, visible=False)

    def _choose(self, name: str, value: Any) -> None:
        review = self._session.view.review.model_copy(update={name: value})
        self._session.change(review=review)

    def _end_and_score(self) -> None:
        answers = self._desk.end_with_known_answers()
        if answers is None:
            return
        self._session.refresh()

        def show(score: AnswerScore) -> None:
            self._show_score(answers, score)
            self._job.end()

        self._job.begin(
            "score",
            lambda _: score_layer(answers.labels, answers.layer, answers.known),
            show,
        )

    def _show_score(self, answers: KnownAnswers, score: AnswerScore) -> None:
        content = score_html(score, answers.layer, answers.known, answers.runs)
        update_widget(self._score, content=content, visible=True)
