"""Every control of the page says on hover what it is for."""

from pathlib import Path

from scanloom.server.workbench import ServeOptions, Workbench
from tests.app.viser_client import connect

# What a person sets; buttons that say all in their label need no more.
_CONTROLS = {
    "GuiSliderMessage",
    "GuiNumberMessage",
    "GuiDropdownMessage",
    "GuiCheckboxMessage",
    "GuiTextMessage",
    "GuiButtonGroupMessage",
}
# Of the page's own script, never seen.
_HIDDEN = {"page events"}


def test_every_control_has_a_hint(small_scene: Path) -> None:
    options = ServeOptions(recordings=[small_scene], port=0)
    with Workbench(options) as workbench, connect(workbench.address) as browser:
        # The last control of the page: the run that another is compared with.
        browser.find("B")
        controls = [
            widget
            for widget in list(browser.widgets.values())
            if widget.type in _CONTROLS and widget.label not in _HIDDEN
        ]
    assert len(controls) > 50
    assert [widget.label for widget in controls if not widget.props.get("hint")] == []
