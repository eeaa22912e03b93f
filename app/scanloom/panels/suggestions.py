"""Thresholds of the classes, fitted on a layer of labels, to be applied by one click."""

import html
import threading
from collections.abc import Sequence

import viser

from fusion_core.workflows.fuse.settings import ChainSettings
from fusion_core.workflows.labels.labelled_frames import labelled_frames
from fusion_core.workflows.labels.suggestions import Suggestion, suggest_thresholds
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView, clock_offset_ms
from scanloom.page.bridge import PageBridge, press_attributes
from scanloom.page.markup import name_html
from scanloom.page.update_widget import update_widget
from scanloom.panels.label_tables import BOX, table_html, unbroken
from scanloom.panels.review_desk import ReviewDesk
from scanloom.panels.widgets.panel_job import PanelJob

PRESS_APPLY = "suggestion"
NOTHING_TOLD = (
    "The labels do not tell: it takes burrs and good samples, in earlier and in later parts of the "
    "recording."
)


class SuggestionControls:
    """A folder: fit the thresholds on a layer, and apply them one by one."""

    def __init__(
        self,
        gui: viser.GuiApi,
        bridge: PageBridge,
        session: ClientSession,
        desk: ReviewDesk,
        lock: threading.RLock,
    ) -> None:
        self._session, self._desk, self._lock = session, desk, lock
        self._suggested: tuple[Suggestion, ...] = ()
        # The layer and the settings that they were fitted with.
        self._layer, self._settings = "", session.view.settings
        with gui.add_folder("Suggestions", expand_by_default=False):
            self._layers = gui.add_dropdown(
                "By the labels of", ("",), hint="The layer that the thresholds are fitted on"
            )
            self._suggest = gui.add_button(
                "Suggest ε and thresholds",
                hint="Fit each on one half of the labelled scans and try it on the other",
            )
            self._table = gui.add_html("", visible=False)
            self._job = PanelJob(
                gui,
                session,
                lock,
                lambda is_running: update_widget(self._suggest, disabled=is_running),
            )
        self._suggest.on_click(lambda _: self._begin())
        bridge.on_press(PRESS_APPLY, self._apply)

    def show(self, frame_view: FrameView) -> None:
        """Offer the layers, and show what was suggested beside the settings in use."""
        own, view = self._desk.own, frame_view.view
        if own is not None:
            update_widget(self._layers, options=(own.name, *own.told(view.review)))
        with self._lock:
            suggested, layer, fitted = self._suggested, self._layer, self._settings
        # Of another unit, epsilon is another setting.
        is_of_unit = view.settings.noise.epsilon_unit == fitted.noise.epsilon_unit
        is_shown = bool(suggested) and is_of_unit
        if is_shown:
            content = suggestions_html(suggested, layer, view.settings)
            update_widget(self._table, content=content)
        update_widget(self._table, visible=is_shown)

    def forget(self) -> None:
        """Show nothing: it is of another recording."""
        with self._lock:
            self._suggested = ()

    def close(self) -> None:
        """End the running job."""
        self._job.close()

    def _begin(self) -> None:
        frame_view, own = self._session.frame_view, self._desk.own
        if own is None or frame_view is None or frame_view.chain is None:
            return
        chain, view, name = frame_view.chain, self._session.view, self._layers.value
        offset_ms = clock_offset_ms(view, chain)

        def keep(suggested: tuple[Suggestion, ...]) -> None:
            with self._lock:
                self._suggested, self._layer, self._settings = suggested, name, view.settings
            self._job.end()

        self._job.begin(
            "suggestions",
            lambda progress: suggest_thresholds(
                labelled_frames(chain, view.settings, own.labels.layer(name), offset_ms, progress),
                chain.alignment,
                view.settings,
            ),
            keep,
        )

    def _apply(self, setting: str) -> None:
        with self._lock:
            found = [one for one in self._suggested if one.setting == setting]
        for suggestion in found:
            if suggestion.fit is not None:
                kind = type(getattr(self._session.view.settings.noise, setting))
                self._session.change_setting("noise", setting, kind(suggestion.fit.value))


def suggestions_html(suggested: Sequence[Suggestion], layer: str, settings: ChainSettings) -> str:
    """Each setting's value in use and suggested, with its interval and the scores of both on the
    scans that were left out, and a button that applies it."""
    rows = []
    for one in suggested:
        fit, in_use = one.fit, float(getattr(settings.noise, one.setting))
        help_text = html.escape(type(settings.noise).model_fields[one.setting].description or "")
        name = f'<span title="{help_text}">{_setting_name(one.setting, settings)}</span>'
        if fit is None:
            rows.append((name, [f"{in_use:g}", f'<span title="{NOTHING_TOLD}">–</span>', "", ""]))
            continue
        button = "in use"
        if in_use != fit.value:
            button = (
                f"<button {press_attributes(PRESS_APPLY, one.setting)} "
                f'title="Undo in another step takes it back">Apply</button>'
            )
        score = unbroken(f"{fit.score_of_current:.2f} → {fit.score_of_value:.2f}")
        rows.append(
            (
                name,
                [
                    f"{fit.current:g}",
                    f"{fit.value:.3g} {unbroken(f'({fit.low:.3g}–{fit.high:.3g})')}",
                    f"<b>{score}</b>" if fit.is_better else score,
                    button,
                ],
            )
        )
    told = next((one.fit for one in suggested if one.fit is not None), None)
    if told is None:
        return f"{BOX}<p>{NOTHING_TOLD}</p></div>"
    return (
        f"{BOX}<p>By the labels of {name_html(layer)}: fitted on {told.fitted_scans} scans, tried "
        f"on the {told.tried_scans} others</p>"
        f"{table_html(['Setting', 'was', 'suggested (95 %)', 'score', ''], rows)}"
        "<p>Score: recall of noise + recall of good - 1 on the scans left out, as it was and with "
        "the suggestion; bold where that is better. Each is fitted alone: suggest again once one "
        "is applied.</p></div>"
    )


def _setting_name(setting: str, settings: ChainSettings) -> str:
    if setting == "epsilon":
        unit = {"sigma": "σ"}.get(settings.noise.epsilon_unit, settings.noise.epsilon_unit)
        return f"ε ({unit})"
    return setting.replace("_", " ")
