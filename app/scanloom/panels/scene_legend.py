"""The legend of the 3D scene: what each layer looks like, and its switch."""

import html
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import viser

from fusion_core.model.classes import NoiseClass
from scanloom.client_session import ClientSession
from scanloom.page.bridge import PageBridge, press_attributes
from scanloom.panels.widgets.controls import update_widget
from scanloom.plots.palette import Color, class_color, color_of
from scanloom.scene.layers import LAYERS
from scanloom.scene.stage_colors import HOLLOW, OUTLINE, stage_colors
from scanloom.state.view import Layer, PanelName, View

_PRESS = "layer"
Shape = Literal["line", "thin", "dot", "ring", "cross", "diamond", "square", "arrow"]
# SVG of each shape in a box of 16 x 16, in the colours {fill} and {edge}.
_SVG: dict[Shape, str] = {
    "line": '<path d="M1 8H15" stroke="{edge}" stroke-width="7"/>'
    '<path d="M1 8H15" stroke="{fill}" stroke-width="4"/>',
    "thin": '<path d="M1 8H15" stroke="{fill}" stroke-width="1.5"/>',
    "dot": '<circle cx="8" cy="8" r="4" fill="{fill}" stroke="{edge}" stroke-width="1.5"/>',
    "ring": '<circle cx="8" cy="8" r="5" fill="none" stroke="{edge}" stroke-width="5"/>'
    '<circle cx="8" cy="8" r="5" fill="none" stroke="{fill}" stroke-width="2.6"/>',
    "cross": '<path d="M3 3L13 13M3 13L13 3" stroke="{edge}" stroke-width="5"/>'
    '<path d="M3 3L13 13M3 13L13 3" stroke="{fill}" stroke-width="2.6"/>',
    "diamond": '<path d="M8 2L14 8L8 14L2 8Z" fill="none" stroke="{edge}" stroke-width="4.6"/>'
    '<path d="M8 2L14 8L8 14L2 8Z" fill="none" stroke="{fill}" stroke-width="2.2"/>',
    "square": '<rect x="2" y="2" width="12" height="12" fill="{fill}"/>',
    "arrow": '<path d="M1 8H14M9 3L14 8L9 13" fill="none" stroke="{fill}" stroke-width="2"/>',
}
_CLASS_SHAPES: dict[NoiseClass, Shape] = {
    NoiseClass.GOOD: "dot",
    NoiseClass.HOLE: "ring",
    NoiseClass.BURR: "cross",
    NoiseClass.CONFLICT: "diamond",
}
_LAYER_SHAPES: dict[Layer, Shape] = {
    "surface": "square",
    "curve": "line",
    "rays": "thin",
    "matched": "line",
    "rows": "thin",
    "pairs": "dot",
    "classes": "diamond",
    "repairs": "arrow",
    "sensors": "square",
    "labels": "square",
    "floor": "thin",
    "map": "square",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class LegendEntry:
    """A line of the legend. ``toggle`` switches the layer, or shows or hides a class."""

    label: str
    help: str
    color: Color
    shape: Shape
    is_visible: bool
    toggle: Callable[[], None]

    @property
    def swatch(self) -> str:
        """The shape in its colour, as SVG."""
        colors = {"fill": _css(self.color), "edge": _css(OUTLINE)}
        shape = _SVG[self.shape].format(**colors)
        return f'<svg width="16" height="16" viewBox="0 0 16 16">{shape}</svg>'


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
                color=_layer_color(layer, is_dark),
                shape=_LAYER_SHAPES[layer],
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
        color=class_color(noise),
        shape=_CLASS_SHAPES[noise],
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
        "classes": HOLLOW,
        "repairs": colors.ink,
        "sensors": colors.camera,
        "labels": colors.ink,
        "floor": colors.section,
        "map": (150, 154, 160),
    }
    return by_layer[layer]


def _css(color: Color) -> str:
    return "#{:02x}{:02x}{:02x}".format(*color)


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
