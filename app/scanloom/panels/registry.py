"""The panels of the workbench, in one table.

To add a panel:

1. Add its name to ``PanelName`` in ``app/scanloom/state/view.py``; the order there is that of the
   buttons and of the keys Alt + 1, Alt + 2, ...
2. Write ``app/scanloom/panels/<name>.py``. Numbers come from the workflows or from a function in
   ``app/scanloom/scene/``, here ``range_histogram(scan) -> (range_m, beams)``::

    from scanloom.frame_view import FrameView
    from scanloom.page_parts import Panel
    from scanloom.plots.line_plot import (
        PlotLabels, add_line_plot, line, set_limits, whole_limits
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
                set_limits(self._plot, *whole_limits(beams))
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

from scanloom.client_session import ClientSession
from scanloom.page.bridge import PageBridge
from scanloom.page.layout import PageLayout
from scanloom.page_parts import Panel
from scanloom.panels.alignment_bar import AlignmentBar
from scanloom.panels.arrangement import ArrangementPanel
from scanloom.panels.batch_walk import BatchWalkPanel
from scanloom.panels.calibrate import CalibratePanel
from scanloom.panels.camera_gizmo import CameraGizmo
from scanloom.panels.header import HeaderPanel, PresetPanel
from scanloom.panels.map import MapPanel
from scanloom.panels.match import MatchPanel
from scanloom.panels.opening import OpeningDialog
from scanloom.panels.pictures import DepthImagePanel, SimilarityPanel
from scanloom.panels.profile import ProfilePanel
from scanloom.panels.recording import RecordingPanel
from scanloom.panels.register import RegisterPanel
from scanloom.panels.repair import RepairPanel
from scanloom.panels.review import ReviewPanel
from scanloom.panels.scene import ScenePanel
from scanloom.panels.stepper import StepperPanel
from scanloom.panels.timeline import TimelinePanel
from scanloom.state.view import PANELS, PanelName


@dataclass(frozen=True, kw_only=True)
class PanelContext:
    """What the steps' panels are built from. ``scene`` takes the map that they show."""

    gui: viser.GuiApi
    session: ClientSession
    client: viser.ClientHandle
    bridge: PageBridge
    scene: ScenePanel
    output_root: Path


_BUILDERS: Mapping[PanelName, Callable[[PanelContext], Panel]] = {
    "Recording": lambda context: RecordingPanel(context.gui, context.session),
    "Match": lambda context: MatchPanel(context.gui, context.session),
    "Register": lambda context: RegisterPanel(context.gui, context.session),
    "Repair": lambda context: RepairPanel(context.gui, context.session),
    "Review": lambda context: ReviewPanel(context.client, context.bridge, context.session),
    "Map": lambda context: MapPanel(
        context.gui,
        context.session,
        context.output_root,
        context.scene.set_map,
        context.scene.mark_cell,
        context.scene.visual,
    ),
    "Calibrate": lambda context: CalibratePanel(
        context.client, context.bridge, context.session, context.output_root
    ),
}


def add_panels(client: viser.ClientHandle, session: ClientSession, output_root: Path) -> None:
    """Build a browser's page from top to bottom, and have the session update it."""
    gui = client.gui
    bridge = PageBridge(gui)
    layout = PageLayout(gui)
    with layout.depth:
        depth = DepthImagePanel(gui, bridge, session)
    with layout.similarity:
        similarity = SimilarityPanel(gui, bridge, session)
    with layout.time:
        timeline = TimelinePanel(gui, bridge, session)
        profile = ProfilePanel(gui, bridge, session)
    header = HeaderPanel(gui, bridge, session)
    walk = BatchWalkPanel(gui, bridge, session)
    bar = AlignmentBar(gui)
    stepper = StepperPanel(gui, bridge, session)
    folders = {name: stepper.folder(name) for name in PANELS}
    with gui.add_folder("Settings and view", expand_by_default=False):
        preset = PresetPanel(gui, session)
        scene = ScenePanel(client, bridge, session)
    context = PanelContext(
        gui=gui,
        session=session,
        client=client,
        bridge=bridge,
        scene=scene,
        output_root=output_root,
    )
    steps: list[Panel] = []
    for name, folder in folders.items():
        with folder:
            steps.append(_BUILDERS[name](context))
        stepper.add_help(name)

    opening = OpeningDialog(client, bridge, session, walk)
    # What a person looks at while a slider moves comes first, and the noise along time, which is
    # counted behind, after it. The bar goes once all is aligned.
    pictures = depth, similarity
    arrangement = ArrangementPanel(bridge, session, layout, pictures, timeline, profile)
    top = [arrangement, header, walk, stepper, preset]
    gizmo = CameraGizmo(client, session)
    views = [similarity, depth, profile, *steps, scene, gizmo, timeline]
    session.panels = [*top, *views, bar, opening]
