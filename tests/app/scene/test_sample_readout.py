"""The read-out of a sample: its values in the displayed frame, none beyond it."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fusion_core.model.classes import NoiseClass
from scanloom.scene.sample_readout import linked, readout_text
from scanloom.state.hover import Hover
from scanloom.state.view import View

ROWS, COLUMNS = 4, 6
U_FIRST = -2


def frame_view(*, classes: Any = None) -> Any:
    """Beams 10, 11 and 12, the last one without a pixel, of a scan of 20."""
    depth_m = np.full((ROWS, COLUMNS), 2.5, dtype=np.float32)
    depth_m[0, 0] = np.nan
    scores = np.linspace(0.0, 0.99, ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    scores[0, 0] = np.nan
    pairs = SimpleNamespace(
        beam=np.array([10, 11, 12]),
        row=np.array([3, 2, -1]),
        column=np.array([4, 5, -1]),
        azimuth_rad=np.deg2rad([5.0, -5.0, -6.0]),
        lidar_range_m=np.array([2.0, np.nan, 2.0]),
        depth_as_range_m=np.array([2.1, 2.2, np.nan]),
    )
    match = SimpleNamespace(
        depth_m=depth_m,
        correspondence=pairs,
        scan=SimpleNamespace(ranges_m=np.full(20, 3.0)),
        search=SimpleNamespace(
            fields={"pearson": SimpleNamespace(scores=scores, u_first=U_FIRST)},
        ),
    )
    view = View(recording="a room", field_scope="frame").with_setting("search", "metric", "pearson")
    fused = None if classes is None else SimpleNamespace(classes=classes)
    return SimpleNamespace(view=view, match=match, fused=fused)


def test_a_pixel_has_its_depth() -> None:
    assert readout_text(frame_view(), Hover(source="depth", row=3, column=4)) == (
        "row 3, column 4: depth 2.50 m"
    )
    assert "no depth" in readout_text(frame_view(), Hover(source="depth", row=0, column=0))


@pytest.mark.parametrize(("row", "column"), [(ROWS, 0), (0, COLUMNS), (-1, 0), (0, -1)])
def test_a_pixel_of_another_frames_larger_image_has_its_place_alone(row, column) -> None:
    hover = Hover(source="depth", row=row, column=column)
    assert readout_text(frame_view(), hover) == f"row {row}, column {column}"


def test_an_offset_has_its_score() -> None:
    last = Hover(source="similarity", u=U_FIRST + COLUMNS - 1.0, v=ROWS - 1.0)
    assert readout_text(frame_view(), last).endswith("similarity 0.99 of 1")
    first = Hover(source="similarity", u=float(U_FIRST), v=0.0)
    assert "no score" in readout_text(frame_view(), first)


@pytest.mark.parametrize(
    ("u", "v"),
    [(U_FIRST - 1.0, 0.0), (U_FIRST + COLUMNS + 0.0, 0.0), (0.0, ROWS + 0.0), (0.0, -1.0)],
)
def test_an_offset_of_another_frames_larger_field_has_its_place_alone(u, v) -> None:
    assert len(readout_text(frame_view(), Hover(source="similarity", u=u, v=v)).splitlines()) == 1


def test_a_beam_has_its_ranges_and_classes() -> None:
    classes = SimpleNamespace(
        lidar_class=np.array([NoiseClass.CONFLICT, NoiseClass.HOLE, NoiseClass.BURR]),
        depth_class=np.array([NoiseClass.CONFLICT, NoiseClass.GOOD, -1]),
    )
    shown = frame_view(classes=classes)
    assert readout_text(shown, Hover(source="profile", beam=10)).splitlines() == [
        "beam 10, 5.0° left",
        "LiDAR 2.00 m, camera 2.10 m",
        "beam: conflict, pixel: conflict",
    ]
    assert "LiDAR nothing, camera 2.20 m" in readout_text(shown, Hover(beam=11))
    assert readout_text(shown, Hover(beam=12)).endswith("\nbeam: burr")
    assert "outside the camera's view" in readout_text(shown, Hover(beam=3))
    assert readout_text(shown, Hover(beam=20)) == ""


def test_a_beam_brings_its_pixel_and_row() -> None:
    hover = Hover(source="profile", beam=11)
    assert linked(frame_view(), hover) == Hover(source="profile", beam=11, row=2, column=5, v=2.0)
    for alone in (Hover(beam=12), Hover(beam=3), Hover(row=1, column=1)):
        assert linked(frame_view(), alone) == alone
