"""Findings: counts, conflicts and one beam's facts, from a frame of seven beams made by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from fusion_core.denoising.correspondence import Correspondence
from fusion_core.denoising.noise import Classification
from fusion_core.denoising.repair import Repair
from fusion_core.model.classes import NoiseClass, RepairSource
from scanloom.scene.frame_summary import (
    ConflictRun,
    conflict_runs,
    counts_of_beams,
    counts_of_pairs,
    counts_of_pixels,
    facts_of_beam,
)

GOOD, HOLE, BURR, CONFLICT = NoiseClass
RAW, OTHER, NEIGHBOURS, NONE = RepairSource
NAN = np.nan
ALL = frozenset(NoiseClass)


def frame(first_rad: float = 0.3) -> SimpleNamespace:
    """Beams 100 to 107 without 104; azimuths fall by 0.1 from one to the next."""
    lidar = np.array([2.0, NAN, 1.2, 3.0, 3.1, 4.0, NAN])
    depth = np.array([2.0, 2.1, 2.2, 1.0, 1.1, 1.5, NAN])
    pairs = Correspondence(
        model="curve",
        beam=np.array([100, 101, 102, 103, 105, 106, 107]),
        row=np.array([5, 5, 5, 6, 6, 6, -1]),
        column=np.array([0, 1, 2, 3, 4, 5, -1]),
        azimuth_rad=np.angle(np.exp(1j * (first_rad - 0.1 * np.arange(7)))),
        lidar_range_m=lidar,
        depth_m=depth,
        depth_as_range_m=depth + 0.1,
        lidar_as_depth_m=lidar - 0.1,
        camera_range_m=np.array([2.0, 2.2, 2.3, NAN, NAN, NAN, NAN]),
        camera_blocked=np.zeros(7, dtype=np.bool_),
        residual_m=depth + 0.1 - lidar,
    )
    classes = Classification(
        lidar_class=np.array([GOOD, HOLE, BURR, CONFLICT, CONFLICT, CONFLICT, HOLE]),
        depth_class=np.array([GOOD, GOOD, GOOD, CONFLICT, CONFLICT, CONFLICT, -1]),
        lidar_confidence=np.linspace(0.3, 0.9, 7),
        depth_confidence=np.linspace(0.2, 0.8, 7),
        epsilon_m=np.full(7, 0.2),
        lidar_steady=np.array([True, False, False, True, True, True, False]),
        lidar_decided=np.zeros(7, dtype=np.bool_),
        depth_decided=np.zeros(7, dtype=np.bool_),
        beam_evidence=np.arange(35.0).reshape(7, 5),
        beam_support=np.arange(21).reshape(7, 3),
        pixel_support=np.arange(14).reshape(7, 2),
        pixel_unconfirmed=np.zeros(7, dtype=np.bool_),
        pixel_through=np.zeros(7, dtype=np.bool_),
    )
    repair = Repair(
        lidar_range_m=np.array([2.0, 2.2, 2.3, 3.0, 3.1, 4.0, NAN]),
        lidar_source=np.array([RAW, OTHER, OTHER, RAW, RAW, RAW, NONE]),
        lidar_errors_m=np.array([[0.01, 0.02]] * 7),
        depth_m=depth.copy(),
        depth_source=np.array([RAW] * 6 + [NONE]),
        depth_errors_m=np.full((7, 2), NAN),
    )
    match = SimpleNamespace(correspondence=pairs)
    return SimpleNamespace(match=match, classes=classes, repair=repair)


def test_beams_and_pixels_are_counted_by_class_and_by_what_became_of_them() -> None:
    beams, pixels = counts_of_beams(frame()), counts_of_pixels(frame())
    assert beams.by_class == {GOOD: 1, HOLE: 2, BURR: 1, CONFLICT: 3}
    # A good value and a conflict stay, and were not asked to be repaired.
    assert beams.by_source == {RAW: 0, OTHER: 2, NEIGHBOURS: 0, NONE: 1}
    assert beams.without_pixel == 0
    assert pixels.by_class == {GOOD: 3, HOLE: 0, BURR: 0, CONFLICT: 3}
    assert pixels.by_source == dict.fromkeys(RepairSource, 0)
    assert pixels.without_pixel == 1


def test_a_pair_has_the_worse_class_of_its_sides_and_a_good_beam_alone_has_none() -> None:
    seven = frame()
    pair_class = np.maximum(seven.classes.lidar_class, seven.classes.depth_class)
    seven.pair_class = pair_class
    pairs = counts_of_pairs(seven)
    assert pairs.by_class == {GOOD: 1, HOLE: 2, BURR: 1, CONFLICT: 3}
    assert (pairs.without_pixel, pairs.total) == (0, 7)
    # The last beam returns now, beside the image; the first one's pixel is empty.
    pair_class[[0, 6]] = HOLE, GOOD
    pairs = counts_of_pairs(seven)
    assert pairs.by_class == {GOOD: 0, HOLE: 2, BURR: 1, CONFLICT: 3}
    assert (pairs.without_pixel, pairs.total) == (1, 7)


def test_adjacent_conflicts_are_one_and_the_greatest_disagreement_is_first() -> None:
    first, second = conflict_runs(frame())
    # Beams 105 and 106 disagree by 1.9 and 2.4 m, beam 103 by 1.9 m; beam 104 is not in view.
    assert first == ConflictRun(
        first=105, last=106, middle=106, lidar_m=pytest.approx(3.55), camera_m=pytest.approx(1.4)
    )
    assert (second.first, second.last, second.middle) == (103, 103, 103)


def test_a_frame_without_conflicts_has_none() -> None:
    calm = frame()
    codes = calm.classes.lidar_class.copy()
    codes[codes == CONFLICT] = GOOD
    calm.classes = SimpleNamespace(lidar_class=codes)
    assert conflict_runs(calm) == []


def test_the_facts_of_a_beam_are_those_of_the_frame() -> None:
    facts = facts_of_beam(frame(), 102)
    assert facts is not None
    assert facts.pixel is not None
    assert (facts.row, facts.column) == (5, 2)
    assert facts.residual_m == pytest.approx(1.1)
    assert (facts.epsilon_m, facts.camera_range_m) == (0.2, 2.3)
    assert facts.pixel_range_m == pytest.approx(2.3)
    assert facts.lidar_as_depth_m == pytest.approx(1.1)
    assert facts.azimuth_deg == pytest.approx(np.rad2deg(0.1))
    assert facts.lidar.noise_class is BURR
    assert facts.lidar.source is OTHER
    assert (facts.lidar.raw_m, facts.lidar.repaired_m) == (1.2, 2.3)
    assert (facts.lidar.from_other_m, facts.lidar.from_neighbours_m) == (0.01, 0.02)
    assert facts.lidar.confidence == pytest.approx(0.5)
    assert facts.pixel.noise_class is GOOD
    assert facts.pixel.raw_m == 2.2
    assert facts.supporters == (6, 7, 8)
    assert facts.pixel_supporters == (4, 5)
    assert not facts.steady


def test_a_beam_may_have_no_pixel_or_lie_out_of_view() -> None:
    outside = facts_of_beam(frame(), 107)
    assert outside is not None
    assert outside.pixel is None
    assert facts_of_beam(frame(), 104) is None
    assert facts_of_beam(frame(), 0) is None
