"""The panels of the workbench, in one table.

To add a panel:

1. Add its name to ``PanelName`` in ``app/scanloom/state/view.py``; the order there is that of the
   buttons and of the keys Alt + 1, Alt + 2, ...
2. Write ``app/scanloom/panels/<name>.py``. Numbers come from the workflows or from a function in
   ``app/scanloom/scene/``, here ``range_histogram(scan) -> (range_m, beams)``::

    from scanloom.client_session import Panel
    from scanloom.frame_view import FrameView
    from scanloom.plots.line_plot import (
        PlotLabels, add_line_plot, line, set_y_limits, whole_limits
    )
    from scanloom.plots.palette import color_of
    from scanloom.scene.range_histogram import range_histogram

    class RangesPanel(Panel):
        \"""Histogram of the scan's ranges.\"""

        def __init__(self, gui: viser.GuiApi) -> None:
            labels = PlotLabels(title="Ranges", x="range (m)", x_short="range (m)", y="beams")
            self._plot = add_line_plot(gui, labels, [line("beams", color_of("lidar"))])

        def show(self, frame_view: FrameView) -> None:
            match = frame_view.match
            if frame_view.view.panel == "Ranges" and match is not None:
                range_m, beams = range_histogram(match.scan)
                self._plot.data = range_m, beams
                set_y_limits(self._plot, *whole_limits(beams))
            # Hidden at first, and where the frame has no result.
            self._plot.visible = match is not None

3. Add it to ``_BUILDERS`` below.
4. Write its help, ``static/help/<name>.md``: 120 to 200 words under the headings of the others,
   the place in the paper, ``![Formula](<name>.svg)``. The formula and its words stand in
   ``FORMULAS`` (``tests/pictures/formulas.py``); ``python -m tests.pictures.formulas`` draws it.

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
