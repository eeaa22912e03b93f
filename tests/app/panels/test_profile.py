"""The range profile is that of what the frame has: pairs, a scan beside an image, or a scan."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fusion_core.model.sensors import LaserScan
from scanloom.panels.profile import ProfilePanel
from scanloom.state.hover import Hover
from scanloom.state.view import View


class Picture:
    def __init__(self) -> None:
        self.rgb: Any = None
        self.marks: Any = None

    def show(self, rgb: Any) -> None:
        self.rgb = rgb

    def mark(self, marks: Any, readout: str = "") -> None:
        self.marks = marks

    def set_tool(self, tool: Any) -> None:
        assert tool is None, "nothing is reviewed"


@pytest.fixture
def panel(monkeypatch: pytest.MonkeyPatch) -> ProfilePanel:
    monkeypatch.setattr(
        "scanloom.panels.profile.LivePicture",
        lambda *_: SimpleNamespace(on_point=lambda _: None, on_stroke=lambda _: None),
    )
    made = ProfilePanel(None, None, SimpleNamespace())  # type: ignore[arg-type]  # none is used
    made._picture = Picture()  # type: ignore[assignment]  # as far as it is used
    return made


def frame_view(**values: Any) -> Any:
    none = {"frame": None, "paired": None, "lone": None, "match": None, "fused": None}
    view = View(recording=Path("a room").name)
    return SimpleNamespace(**none | {"view": view, "is_dark": False, "review": None} | values)


def scan() -> LaserScan:
    return LaserScan(
        stamp_ns=0,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=-1.0,
        angle_increment_rad=0.02,
        ranges_m=np.full(101, 2.0),
        range_min_m=0.1,
        range_max_m=10.0,
    )


def test_a_scan_alone_is_drawn_and_its_beams_light_up(panel: ProfilePanel) -> None:
    shown = frame_view(lone=SimpleNamespace(scan=scan()))
    panel.show(shown)
    assert panel._picture.rgb is not None  # type: ignore[attr-defined]  # the test's own picture
    panel.show_hover(shown, Hover(source="scene", beam=50))
    assert len(panel._picture.marks) == 1  # type: ignore[attr-defined]  # the test's own picture
    panel.show_hover(shown, Hover())
    assert panel._picture.marks == []  # type: ignore[attr-defined]  # the test's own picture


def test_without_a_scan_there_is_no_profile(panel: ProfilePanel) -> None:
    panel.show(frame_view(lone=SimpleNamespace(scan=None)))
    assert panel._picture.rgb is None  # type: ignore[attr-defined]  # the test's own picture
    panel.show(frame_view(paired=SimpleNamespace(window=None)))
    assert panel._picture.rgb is None  # type: ignore[attr-defined]  # the test's own picture
