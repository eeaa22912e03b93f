"""The panels of the workbench, in one table.

To add a panel:

1. Add its name to ``PanelName`` in ``scanloom/state/view.py``; the order there is that of the
   buttons and of the keys Alt + 1…9.
2. Write ``scanloom/panels/<name>.py`` with a class like this::

    class RangesPanel(Panel):
        \"""Histogram of the scan's ranges.\"""

        def __init__(self, gui: viser.GuiApi) -> None:
            empty = (np.array([0.0, 1.0]), np.zeros(2))
            series = (uplot.Series(label="range (m)"), uplot.Series(label="beams", stroke="blue"))
            self._plot = gui.add_uplot(empty, series, aspect=1.5)

        def show(self, frame_view: FrameView) -> None:
            match = frame_view.match
            if frame_view.view.panel != "Ranges" or match is None:
                return
            ranges_m = match.scan.ranges_m
            count, edges_m = np.histogram(ranges_m[np.isfinite(ranges_m)], bins=40)
            self._plot.data = edges_m[:-1], count.astype(float)

3. Add it to ``_BUILDERS`` below.
4. Write its help, ``static/help/<name>.md``.

A slider of a setting is one line in the panel's constructor, ``controls.slider(stage, field, …)``
(``scanloom.panels.widgets.controls``); it takes its help text from the setting.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import viser

from scanloom.client_session import ClientSession, Panel
from scanloom.panels.header import HeaderPanel
from scanloom.panels.map import MapPanel
from scanloom.panels.match import MatchPanel
from scanloom.panels.recording import RecordingPanel
from scanloom.panels.register import RegisterPanel
from scanloom.panels.repair import RepairPanel
from scanloom.panels.scene import ScenePanel
from scanloom.panels.timeline import TimelinePanel
from scanloom.panels.widgets.panel_switch import PanelSwitch
from scanloom.state.view import PANELS, PanelName


@dataclass(frozen=True, kw_only=True)
class PanelContext:
    """What panels are built from. ``scene`` takes the heatmap and the map that panels show."""

    gui: viser.GuiApi
    session: ClientSession
    scene: ScenePanel
    output_root: Path


_BUILDERS: Mapping[PanelName, Callable[[PanelContext], Panel]] = {
    "Recording": lambda context: RecordingPanel(context.gui, context.session),
    "Match": lambda context: MatchPanel(
        context.gui, context.session, context.scene.set_heatmap_source
    ),
    "Register": lambda context: RegisterPanel(context.gui, context.session),
    "Repair": lambda context: RepairPanel(context.gui, context.session),
    "Map": lambda context: MapPanel(
        context.gui, context.session, context.output_root, context.scene.set_map
    ),
}


def add_panels(client: viser.ClientHandle, session: ClientSession, output_root: Path) -> None:
    """Build a browser's page from top to bottom, and have the session update it."""
    gui = client.gui
    header = HeaderPanel(gui, session)
    timeline = TimelinePanel(gui, session)
    scene = ScenePanel(client, session)
    switch = PanelSwitch(gui, session)
    context = PanelContext(gui=gui, session=session, scene=scene, output_root=output_root)
    panels: list[Panel] = []
    for name in PANELS:
        with switch.folder(name):
            panels.append(_BUILDERS[name](context))
    # The scene is updated last: it displays what the panels have just drawn.
    session.panels = [header, timeline, switch, *panels, scene]
