"""The legend of the 3D scene: what each layer looks like, and its switch."""

import html
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import viser

from fusion_core.model.classes import NoiseClass
from scanloom.client_session import ClientSession
from scanloom.page.bridge import PageBridge, press_attributes
from scanloom.page.update_widget import update_widget
from scanloom.panels.swatches import Shape, class_swatch, swatch
from scanloom.plots.palette import Color, color_of
from scanloom.scene.layers import LAYERS
from scanloom.scene.stage_colors import stage_colors
from scanloom.state.view import Layer, PanelName, View

_PRESS = "layer"
# The classes have a shape each.
_LAYER_SHAPES: dict[Layer, Shape] = {
    "surface": "square",
    "curve": "line",
    "rays": "thin",
    "matched": "line",
    "rows": "thin",
    "pairs": "dot",
    "repairs": "arrow",
    "sensors": "square",
    "labels": "square",
    "floor": "thin",
    "map": "square",
    "cloud": "dot",
    "keyframes": "diamond",
    "loops": "line",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class LegendEntry:
    """A line of the legend. ``swatch``: SVG. ``toggle`` switches the layer, or shows or hides a
    class."""

    label: str
    help: str
    swatch: str
    is_visible: bool
    toggle: Callable[[], None]


def legend_entries(
    session: ClientSession,
    step: PanelName,
    view: View,
    is_dark: bool,
    absent: frozenset[Layer] = frozenset(),
) -> list[LegendEntry]:
    """The layers that a step shows, and the classes where it shows those. ``absent``: those that
    the recording has nothing for."""
    entries = []
    for layer, info in LAYERS.items():
        if step not in info.steps or layer in absent:
            continue
        if layer == "classes":
            entries += [_class_entry(session, view, noise) for noise in NoiseClass]
            continue
        entries.append(
            LegendEntry(
                label=info.label,
                help=info.help,
                swatch=swatch(_LAYER_SHAPES[layer], _layer_color(layer, is_dark)),
                is_visible=layer not in view.hidden_layers,
                toggle=partial(_switch_layer, session, layer),
            )
        )
    return entries


def _switch_layer(session: ClientSession, layer: Layer) -> None:
    """Switch a layer off, or on again."""
    session.change(hidden_layers=session.view.hidden_layers ^ {layer})


def _class_entry(session: ClientSession, view: View, noise: NoiseClass) -> LegendEntry:
    return LegendEntry(
        label=noise.name.capitalize(),
        help=LAYERS["classes"].help,
        swatch=class_swatch(noise),
        is_visible=noise in view.visible_classes,
        toggle=lambda: session.change(visible_classes=session.view.visible_classes ^ {noise}),
    )


def _layer_color(layer: Layer, is_dark: bool) -> Color:
    colors = stage_colors(is_dark)
    by_layer: dict[Layer, Color] = {
        "surface": (124, 123, 120),
        "curve": color_of("lidar"),
        "rays": colors.ray,
        "matched": color_of("depth"),
        "rows": colors.row,
        "pairs": color_of("depth"),
        "repairs": colors.ink,
        "sensors": colors.camera,
        "labels": colors.ink,
        "floor": colors.section,
        "map": (150, 154, 160),
        "cloud": (124, 123, 120),
        "keyframes": colors.camera,
        "loops": color_of("lidar"),
    }
    return by_layer[layer]


class SceneLegend:
    """The legend: buttons with swatches, which the page shows over the scene."""

    def __init__(self, gui: viser.GuiApi, bridge: PageBridge, session: ClientSession) -> None:
        self._session = session
        self._step = session.view.panel
        self._html = gui.add_html("")
        bridge.on_press(_PRESS, self._toggle)

    def show(
        self, step: PanelName, view: View, is_dark: bool, absent: frozenset[Layer] = frozenset()
    ) -> None:
        """Show the entries of a step, without layers that the recording has nothing for."""
        self._step = step
        entries = legend_entries(self._session, step, view, is_dark, absent)
        update_widget(self._html, content=legend_html(entries, is_dark))

    def _toggle(self, label: str) -> None:
        # A browser may send any value.
        for entry in legend_entries(self._session, self._step, self._session.view, is_dark=False):
            if entry.label == label:
                entry.toggle()


def legend_html(entries: Sequence[LegendEntry], is_dark: bool) -> str:
    """A legend whose entries are buttons, pressed while what they stand for is shown."""
    buttons = "".join(
        f'<button {press_attributes(_PRESS, entry.label)} title="{html.escape(entry.help)}" '
        f'aria-pressed="{str(entry.is_visible).lower()}">{entry.swatch}'
        f"<span>{html.escape(entry.label)}</span></button>"
        for entry in entries
    )
    shade = "dark" if is_dark else "light"
    return f'<div class="scanloom-legend {shade}" role="group" aria-label="Legend">{buttons}</div>'
