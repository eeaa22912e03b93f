"""The pixels of the pairs: filtered by class, found by place, taken from a frame."""

from dataclasses import fields
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fusion_core.model.classes import NoiseClass
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_match import FrameMatch
from scanloom.plots.pair_pixels import PairPixels, pixels_of_match, repaired_depth_m


def pairs() -> PairPixels:
    return PairPixels(
        beam=np.array([40, 41, 42]),
        row=np.array([10, 12, -1]),
        column=np.array([20, 25, -1]),
        noise_class=np.array([0, 2, -1]),
        repaired=np.zeros(3, dtype=np.bool_),
    )


def test_a_filter_keeps_its_classes_and_drops_beams_without_a_pixel() -> None:
    assert pairs().shown({NoiseClass.GOOD}).tolist() == [True, False, False]
    assert pairs().shown(NoiseClass).tolist() == [True, True, False]
    assert pairs().shown(()).tolist() == [False, False, False]


def test_the_nearest_beam_is_found_within_reach() -> None:
    assert pairs().beam_near(11, 24) == 41
    assert pairs().beam_near(10, 20) == 40
    assert pairs().beam_near(-1, -1, within_px=2.0) is None
    assert pairs().beam_near(100, 100) is None


def test_arrays_of_different_length_are_refused() -> None:
    with pytest.raises(ValueError, match="B"):
        PairPixels(
            beam=np.arange(3),
            row=np.arange(2),
            column=np.arange(3),
            noise_class=np.arange(3),
            repaired=np.zeros(3, dtype=np.bool_),
        )


def stages() -> dict[str, Any]:
    """A good pixel, a repaired hole, a hole that nothing could repair, a beam without a pixel."""
    nan = np.nan
    depth_m = np.full((4, 6), 2.0, dtype=np.float32)
    depth_m[1, 1:3] = nan
    return {
        "pair": SimpleNamespace(depth_m=depth_m),
        "correspondence": SimpleNamespace(
            beam=np.array([7, 8, 9, 10]),
            row=np.array([1, 1, 1, -1]),
            column=np.array([0, 1, 2, -1]),
            depth_m=np.array([2.0, nan, nan, nan]),
        ),
        "classes": SimpleNamespace(depth_class=np.array([0, 1, 1, -1])),
        "repair": SimpleNamespace(depth_m=np.array([2.0, 1.5, nan, 3.0])),
    }


def match_of_stages() -> FrameMatch:
    """A match with its image and pairs only."""
    values = stages()
    return FrameMatch(**{field.name: values.get(field.name) for field in fields(FrameMatch)})


def fused_of_stages() -> FusedFrame:
    """The same with classes and repairs."""
    values = stages()
    return FusedFrame(
        match=match_of_stages(),
        classes=values["classes"],
        repair=values["repair"],
        camera_range_m=np.empty(0),
    )


def test_a_fused_frame_gives_classes_and_what_was_repaired() -> None:
    fused = fused_of_stages()
    found = pixels_of_match(fused.match, fused)
    assert found.noise_class.tolist() == [0, 1, 1, -1]
    assert found.repaired.tolist() == [False, True, False, False]
    assert found.beam.tolist() == [7, 8, 9, 10]


def test_a_match_has_no_classes_yet() -> None:
    found = pixels_of_match(match_of_stages())
    assert found.noise_class.tolist() == [-1] * 4
    assert not found.repaired.any()
    assert found.shown(()).tolist() == [True, True, True, False]


def test_the_repaired_image_differs_in_the_repaired_pixels_alone() -> None:
    frame = fused_of_stages()
    raw_m = frame.match.depth_m.copy()
    repaired_m = repaired_depth_m(frame)
    changed = ~np.isclose(repaired_m, raw_m, equal_nan=True)
    assert np.argwhere(changed).tolist() == [[1, 1]]
    assert repaired_m[1, 1] == 1.5
    assert np.array_equal(frame.match.depth_m, raw_m, equal_nan=True)
