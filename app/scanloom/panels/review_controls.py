"""How to mark, what the queue holds, and many answers at once: what a person chooses of it."""

from typing import Any

import viser

from fusion_core.model.classes import NoiseClass
from fusion_core.model.labels import Label
from scanloom.client_session import ClientSession
from scanloom.page.markup import paragraph
from scanloom.page.update_widget import update_widget
from scanloom.panels.review_desk import ReviewDesk
from scanloom.panels.widgets.controls import Controls
from scanloom.state.frame_runs import class_name
from scanloom.state.review_choices import QUEUE_ORDERS, QUEUE_SENSORS, TOOLS, Answer

ANSWERS: dict[str, Answer] = {
    "accept": "accept",
    "reject": "reject",
    "clear": "clear",
    **{label.name.lower(): label for label in Label},
}
"""By what the page and the lists call them."""


class ReviewControls:
    """The folders Marking, Queue and Neighbouring frames."""

    def __init__(
        self, gui: viser.GuiApi, session: ClientSession, desk: ReviewDesk, controls: Controls
    ) -> None:
        self._session, self._desk, self._controls = session, desk, controls
        review = session.view.review
        with gui.add_folder("Marking"):
            tool = gui.add_dropdown(
                "Mark by",
                TOOLS,
                initial_value=review.tool,
                hint="What a drag on the depth image or the range profile marks (B). In the scene "
                "a drag with Shift marks a box. With Shift a box adds to what is marked",
            )
            brush = gui.add_slider(
                "Brush (px)", 1, 40, 1, review.brush_px, hint="Radius of the brush on the image"
            )
            self._comment = gui.add_text(
                "Comment",
                "",
                hint="Kept in the journal with your next answer, then empty again. Esc gives the "
                "keys back",
            )
            self._comment.on_update(self._take_comment)
        with gui.add_folder("Queue", expand_by_default=False):
            order = gui.add_dropdown(
                "Order",
                QUEUE_ORDERS,
                initial_value=review.order,
                hint="Disagreement: runs to which two layers give different labels",
            )
            sensor = gui.add_dropdown(
                "Sensor",
                QUEUE_SENSORS,
                initial_value=review.sensor,
                hint="Runs of beams, of pixels along the curve, or both",
            )
            boxes = [
                (
                    noise,
                    gui.add_checkbox(
                        f"Ask about {class_name(noise)}",
                        noise in review.classes,
                        hint="Runs whose automatic class this is",
                    ),
                )
                for noise in NoiseClass
            ]
            only_open = gui.add_checkbox(
                "Unlabelled only", review.only_open, hint="Pass over runs that have your label"
            )
            advance = gui.add_checkbox(
                "Go on after an answer", review.auto_advance, hint="To the next run of the queue"
            )
            self._all_answer = gui.add_dropdown(
                "Say of all that is open",
                tuple(ANSWERS),
                initial_value="accept",
                hint="Accept: that the automatic class is right",
            )
            everything = gui.add_button("Label all open runs of the queue …")
        with gui.add_folder("Neighbouring frames", expand_by_default=False):
            self._beside = gui.add_slider(
                "Frames on either side", 1, 30, 1, 5, hint="Before and after the displayed one"
            )
            self._around_answer = gui.add_dropdown(
                "Say of this place there",
                tuple(ANSWERS),
                initial_value="accept",
                hint="Of samples of the run's sensor and class that look at the same place; the "
                "recorded poses say where that is",
            )
            around = gui.add_button("Label run and neighbours (I)")
        for name, handle in (
            ("tool", tool),
            ("brush_px", brush),
            ("order", order),
            ("sensor", sensor),
            ("only_open", only_open),
            ("auto_advance", advance),
        ):
            self._bind(name, handle)
        for noise, box in boxes:
            self._bind_class(noise, box)
        everything.on_click(lambda _: self._ask_for_all(gui))
        around.on_click(lambda _: self.answer_around())

    def show(self) -> None:
        """Empty the comment once it has gone with an answer."""
        if not self._desk.comment:
            update_widget(self._comment, value="")

    def answer_around(self) -> None:
        """Say what is chosen of the run and of the same place in neighbouring frames."""
        self._desk.answer_around(ANSWERS[self._around_answer.value], int(self._beside.value))

    def next_tool(self) -> None:
        """Mark by the next of the tools."""
        review = self._session.view.review
        tool = TOOLS[(TOOLS.index(review.tool) + 1) % len(TOOLS)]
        self._session.change(review=review.model_copy(update={"tool": tool}))

    def _bind(self, name: str, handle: Any) -> None:
        def change(value: Any) -> None:
            review = self._session.view.review.model_copy(update={name: value})
            self._session.change(review=review)

        self._controls.bind(handle, lambda view: getattr(view.review, name), change)

    def _bind_class(self, noise: NoiseClass, box: Any) -> None:
        def change(checked: bool) -> None:
            review = self._session.view.review
            others = review.classes - {noise}
            classes = others | {noise} if checked else others
            self._session.change(review=review.model_copy(update={"classes": classes}))

        self._controls.bind(box, lambda view: noise in view.review.classes, change)

    def _ask_for_all(self, gui: viser.GuiApi) -> None:
        count, answer = len(self._desk.open_numbers()), self._all_answer.value
        with gui.add_modal("Label all that is open") as modal:
            gui.add_html(
                paragraph(
                    f"{count} runs of the queue have no label. Say “{answer}” of all of them? It "
                    "is one action, which undo takes back."
                )
            )
            sure = gui.add_button(f"Label {count} runs", disabled=not count)
            cancel = gui.add_button("Cancel", color="gray")
        cancel.on_click(lambda _: modal.close())

        @sure.on_click
        def _(_: object) -> None:
            modal.close()
            self._desk.answer_all(ANSWERS[answer])

    def _take_comment(self, event: viser.GuiEvent[Any]) -> None:
        # No client: it was emptied by ``show``.
        if event.client is not None:
            self._desk.comment = self._comment.value
