"""A person's labels over the classes, against a plain loop, and what the repair makes of them."""

from dataclasses import fields

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.denoising.overruling import overrule
from fusion_core.model.classes import RepairSource
from fusion_core.model.labels import NO_LABEL, Label
from tests.denoising.test_repair import SETTINGS, frame, repair_frame

GOOD, HOLE, BURR, CONFLICT, UNSURE = Label
CODES = st.sampled_from([NO_LABEL, *(int(label) for label in Label)])
SIDES = st.lists(
    st.tuples(CODES, CODES, st.integers(0, 3), st.integers(-1, 3)), min_size=1, max_size=12
)


@given(SIDES)
def test_a_label_takes_the_place_of_its_side_s_class_and_no_other(sides) -> None:
    lidar, depth, lidar_class, depth_class = (
        np.array(column) for column in zip(*sides, strict=True)
    )
    count = len(sides)
    confidence = np.linspace(0.1, 0.9, count)
    _, classes = frame(
        np.full(count, 2.0),
        lidar_class=lidar_class,
        depth_class=depth_class,
        lidar_confidence=confidence.copy(),
        depth_confidence=confidence.copy(),
    )
    found = overrule(classes, lidar, depth)
    for index in range(count):
        for side, label in (("lidar", lidar[index]), ("depth", depth[index])):
            own = getattr(classes, f"{side}_class")[index]
            decided = label not in (NO_LABEL, UNSURE) and own != -1
            assert getattr(found, f"{side}_class")[index] == (label if decided else own)
            expected = 1.0 if decided else confidence[index]
            assert getattr(found, f"{side}_confidence")[index] == expected
            assert getattr(found, f"{side}_decided")[index] == decided
    judged = ("class", "confidence", "decided")
    for field in fields(classes):
        if not field.name.endswith(judged):
            np.testing.assert_array_equal(getattr(found, field.name), getattr(classes, field.name))


COUNT = 21
MIDDLE = 10


def wall_with(label, *, side="lidar", middle=2.0, automatic=GOOD, settings=SETTINGS, **given_):
    """A flat wall at 2 m that both sensors see, whose middle sample is another; its label."""
    lidar, depth = np.full(COUNT, 2.0), np.full(COUNT, 2.0)
    (lidar if side == "lidar" else depth)[MIDDLE] = middle
    image = np.tile(depth.astype(np.float32), (60, 1))
    if side == "depth":
        image[:, MIDDLE] = 2.0
        image[30, MIDDLE] = middle
    lidar_class = np.where(np.isfinite(lidar), int(GOOD), int(HOLE))
    if np.isfinite(lidar[MIDDLE]):
        lidar_class[MIDDLE] = automatic
    pairs, classes = frame(
        lidar,
        depth=depth,
        camera=np.full(COUNT, 2.0),
        lidar_as_depth=np.full(COUNT, 2.0),
        lidar_class=lidar_class,
        row=np.full(COUNT, 30),
        **given_,
    )
    labels = np.full(COUNT, NO_LABEL)
    labels[MIDDLE] = label
    nothing = np.full(COUNT, NO_LABEL)
    given_labels = (labels, nothing) if side == "lidar" else (nothing, labels)
    result = repair_frame(pairs, overrule(classes, *given_labels), image, settings)
    value = result.lidar_range_m if side == "lidar" else result.depth_m
    source = result.lidar_source if side == "lidar" else result.depth_source
    others = np.delete(np.arange(COUNT), MIDDLE)
    assert (source[others] == RepairSource.RAW).all()
    return value[MIDDLE], source[MIDDLE]


def test_good_and_conflict_keep_what_is_there_and_what_is_not() -> None:
    for side in ("lidar", "depth"):
        for label in (GOOD, CONFLICT):
            assert wall_with(label, side=side, middle=1.0) == (1.0, RepairSource.RAW)
            value, source = wall_with(label, side=side, middle=np.nan)
            assert np.isnan(value)
            assert source == RepairSource.NONE


def test_a_hole_and_a_burr_lose_their_value_and_are_filled() -> None:
    for side in ("lidar", "depth"):
        for label in (HOLE, BURR):
            value, source = wall_with(label, side=side, middle=1.0)
            assert abs(value - 2.0) < 0.05
            assert source in (RepairSource.OTHER_SENSOR, RepairSource.NEIGHBOURS)


def test_no_guard_of_the_repair_holds_against_a_person() -> None:
    # Three scans and the camera beside it confirm the beam, and the class was most unsure.
    evidence = np.zeros((COUNT, 5))
    evidence[:, -1] = 5.0
    guards = {
        "lidar_steady": np.ones(COUNT, dtype=np.bool_),
        "beam_evidence": evidence,
        "lidar_confidence": np.full(COUNT, 0.01),
    }
    strict = SETTINGS.model_copy(update={"lidar_burr_confidence": 0.98})
    for name in guards:
        guard = {"lidar_confidence": np.ones(COUNT), name: guards[name]}
        found = wall_with(NO_LABEL, middle=1.0, automatic=BURR, settings=strict, **guard)
        assert found == (1.0, RepairSource.RAW), name
        value, _ = wall_with(BURR, middle=1.0, settings=strict, **guard)
        assert abs(value - 2.0) < 0.05, name


def test_a_burr_that_nothing_fills_becomes_a_hole() -> None:
    pairs, classes = frame(np.full(COUNT, 2.0), lidar_class=np.full(COUNT, int(GOOD)))
    labels = np.full(COUNT, int(BURR))
    image = np.full((60, COUNT), np.nan, dtype=np.float32)
    result = repair_frame(pairs, overrule(classes, labels, np.full(COUNT, NO_LABEL)), image)
    assert np.isnan(result.lidar_range_m).all()
    assert (result.lidar_source == RepairSource.NONE).all()


def test_unsure_leaves_the_automatic_class() -> None:
    classes = np.full(COUNT, int(BURR))
    pairs, automatic = frame(np.full(COUNT, 2.0), lidar_class=classes)
    labels = np.full(COUNT, int(UNSURE))
    found = overrule(automatic, labels, labels)
    np.testing.assert_array_equal(found.lidar_class, automatic.lidar_class)
    assert not found.lidar_decided.any()
    assert pairs.beam.size == COUNT


def test_a_good_beam_without_a_range_is_no_side_of_a_gap() -> None:
    lidar = np.full(COUNT, 2.0)
    lidar[MIDDLE : MIDDLE + 2] = np.nan
    pairs, classes = frame(lidar, lidar_class=np.where(np.isfinite(lidar), int(GOOD), int(HOLE)))
    labels = np.full(COUNT, NO_LABEL)
    labels[MIDDLE] = GOOD
    image = np.full((60, COUNT), np.nan, dtype=np.float32)
    result = repair_frame(pairs, overrule(classes, labels, np.full(COUNT, NO_LABEL)), image)
    assert np.isnan(result.lidar_range_m[MIDDLE])
    assert result.lidar_source[MIDDLE + 1] == RepairSource.NEIGHBOURS
    assert abs(result.lidar_range_m[MIDDLE + 1] - 2.0) < 0.05
