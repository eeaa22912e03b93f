"""How far the layers of a recording's labels agree, and a layer of what most of them say."""

import threading
from collections.abc import Sequence

import viser

from fusion_core.workflows.labels.compare_layers import Agreement, agreement_of
from scanloom.client_session import ClientSession
from scanloom.page.markup import paragraph
from scanloom.page.update_widget import update_widget
from scanloom.panels.label_tables import agreement_html
from scanloom.panels.review_desk import ReviewDesk
from scanloom.panels.widgets.panel_job import PanelJob
from scanloom.state.annotated_layer import AnnotatedLayer

# The slider's end: no larger team has labelled one recording.
_LAYERS_MAX = 10


class AgreementControls:
    """A folder: compare the layers, and take over what most of them say. Known answers are no layer
    here while they are known answers."""

    def __init__(
        self, gui: viser.GuiApi, session: ClientSession, desk: ReviewDesk, lock: threading.RLock
    ) -> None:
        self._gui, self._session, self._desk = gui, session, desk
        self._lock = lock
        # The labels and layers that the table is of.
        self._compared: tuple[object, ...] = ()
        with gui.add_folder("Agreement", expand_by_default=False):
            compare = gui.add_button(
                "Compare layers",
                hint="Your layer and all others: percent, κ, α and runs, with 95 % intervals",
            )
            self._table = gui.add_html("", visible=False)
            self._least = gui.add_slider(
                "Layers at least",
                1,
                _LAYERS_MAX,
                1,
                2,
                hint="A sample is decided where so many other layers have a label of it, and more "
                "than half of them the same",
            )
            adjudicate = gui.add_button(
                "Adjudicate by majority …",
                hint="Label what has no label in your layer as most of the others say. What is "
                "left is in the queue by disagreement",
            )
            self._job = PanelJob(gui, session, lock, self._offer)
        self._buttons = compare, adjudicate
        compare.on_click(lambda _: self._compare())
        adjudicate.on_click(lambda _: self._count_majority())

    def show(self) -> None:
        """Hide the table where it is of other layers."""
        update_widget(self._table, visible=self._compared == self._layers())

    def close(self) -> None:
        """End the running job."""
        self._job.close()

    def _layers(self) -> tuple[object, ...]:
        own = self._desk.own
        return () if own is None else (own.labels, own.name, *self._told(own))

    def _told(self, own: AnnotatedLayer) -> tuple[str, ...]:
        return own.told(self._session.view.review)

    def _offer(self, is_running: bool) -> None:
        for button in self._buttons:
            update_widget(button, disabled=is_running)

    def _compare(self) -> None:
        own, compared = self._desk.own, self._layers()
        if own is None:
            return
        # A layer has no labels before the first answer.
        names = sorted({own.name, *self._told(own)} & {*own.labels.layers})

        def show(agreement: Agreement) -> None:
            with self._lock:
                self._compared = compared
            update_widget(self._table, content=agreement_html(agreement))
            self._job.end()

        self._job.begin("agreement", lambda _: agreement_of(own.labels, names), show)

    def _count_majority(self) -> None:
        own, least = self._desk.own, int(self._least.value)
        if own is None:
            return
        layers = self._told(own)

        def ask(count: int) -> None:
            self._job.end()
            self._ask(own, layers, count, least)

        self._job.begin("majority", lambda _: own.majority(layers, least), ask)

    def _ask(self, own: AnnotatedLayer, layers: Sequence[str], count: int, least: int) -> None:
        with self._gui.add_modal("Adjudicate by majority") as modal:
            self._gui.add_html(
                paragraph(
                    f"{count} samples without a label in {own.name} are labelled alike by more "
                    f"than half of the other layers, of {least} or more that decided. Label them "
                    f"so in {own.name}? It is one action, which undo takes back."
                )
            )
            sure = self._gui.add_button(f"Label {count} samples", disabled=not count)
            cancel = self._gui.add_button("Cancel", color="gray")
        cancel.on_click(lambda _: modal.close())

        @sure.on_click
        def _(_: object) -> None:
            modal.close()
            settings_sha256 = self._session.view.settings_sha256
            self._job.begin(
                "adjudication",
                lambda _: own.adjudicate(layers, settings_sha256, least),
                lambda labelled: self._job.end(f"{labelled} samples are labelled in {own.name}."),
            )
