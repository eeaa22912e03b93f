"""What a recording can do of SLAM, and why not the rest."""

from itertools import combinations
from pathlib import Path

import pytest

from fusion_core.workflows.fuse.recorded_streams import open_recorded_streams
from fusion_core.workflows.fuse.session import FuseOptions
from fusion_core.workflows.fuse.settings import PRESETS
from fusion_core.workflows.source import open_source
from scanloom.state.slam_choices import (
    ESTIMATORS,
    MOTIONS,
    SCANS,
    SlamChoices,
    Stream,
    choices_for,
    streams_of,
    supported_choices,
    unsupported_reason,
)

ALL: frozenset[Stream] = frozenset(("lidar", "depth", "color", "odometry", "tf"))


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("scan", SCANS)
def test_who_has_everything_can_do_everything(scan: str, motion: str, estimator: str) -> None:
    choices = SlamChoices.model_validate({"scan": scan, "motion": motion, "estimator": estimator})
    said = unsupported_reason(choices, ALL)
    assert (said is None) == (motion != "none" or estimator != "none")
    assert unsupported_reason(choices, frozenset()) is not None


@pytest.mark.parametrize(
    ("held", "choice", "words"),
    [
        ({"lidar"}, {"scan": "camera"}, "“camera” needs depth images"),
        ({"depth", "odometry"}, {"scan": "lidar"}, "“lidar” needs a LaserScan"),
        ({"lidar", "tf"}, {"scan": "merged"}, "“merged” needs a LaserScan and depth images"),
        ({"lidar", "tf"}, {"motion": "wheel"}, "“wheel” needs odometry, which"),
        ({"lidar"}, {"motion": "recorded"}, "“recorded” needs TF, or odometry, which"),
        ({"lidar", "depth"}, {"motion": "visual"}, "needs colour images and depth images, which"),
        ({"lidar"}, {"motion": "recorded"}, "Possible: laser, fused, none."),
        ({"depth"}, {"scan": "repaired"}, "Possible: camera."),
    ],
)
def test_it_says_what_is_missing_and_what_can_be_done(
    held: set[Stream], choice: dict[str, str], words: str
) -> None:
    said = unsupported_reason(SlamChoices.model_validate(choice), frozenset(held))
    assert said is not None
    assert words in said


def test_odometry_alone_is_a_recorded_motion() -> None:
    assert unsupported_reason(SlamChoices(), frozenset(("lidar", "odometry"))) is None
    assert unsupported_reason(SlamChoices(), frozenset(("lidar", "tf"))) is None


def test_the_streams_of_a_recording_are_found(small_scene: Path) -> None:
    with open_source(small_scene, None) as recording:
        opened = open_recorded_streams(recording, FuseOptions(), PRESETS["default"])
        roles = {topic.role for topic in recording.topics if topic.count}
        assert streams_of(opened) == roles & ALL


def test_visual_slam_needs_colour_and_depth_alone() -> None:
    visual = SlamChoices(estimator="visual", scan="merged", motion="wheel", fusion="table")
    assert unsupported_reason(visual, frozenset(("color", "depth"))) is None
    said = unsupported_reason(visual, frozenset(("depth", "lidar", "odometry")))
    assert said is not None
    assert "SLAM “visual” needs colour images and depth images, which this recording lacks" in said
    assert "Possible: none, particle-filter, pose-graph." in said


def test_a_fusion_needs_both_sensors_and_counts_none_twice() -> None:
    fused = SlamChoices(fusion="bayes", motion="none")
    assert unsupported_reason(fused, frozenset(("lidar", "depth"))) is None
    said = unsupported_reason(fused, frozenset(("lidar", "color")))
    assert said is not None
    assert "Fusion “bayes” needs a LaserScan and depth images" in said
    twice = unsupported_reason(fused.model_copy(update={"scan": "repaired"}), ALL)
    assert twice is not None
    assert "would count twice" in twice


@pytest.mark.parametrize(
    ("held", "estimator"),
    [
        ({"color", "depth"}, "visual"),
        ({"color", "depth", "lidar"}, "pose-graph"),
        ({"lidar"}, "pose-graph"),
        ({"depth", "lidar"}, "pose-graph"),
    ],
)
def test_what_is_chosen_for_a_recording_is_possible(held: set[Stream], estimator: str) -> None:
    wanted = SlamChoices(fusion="table", motion="fused")
    chosen = supported_choices(wanted, frozenset(held))
    assert chosen.estimator == estimator
    assert unsupported_reason(chosen, frozenset(held)) is None
    # Of what is impossible, too.
    visual = wanted.model_copy(update={"estimator": "visual"})
    assert unsupported_reason(supported_choices(visual, frozenset(held)), frozenset(held)) is None


@pytest.mark.parametrize(
    "held", [frozenset(some) for count in range(6) for some in combinations(sorted(ALL), count)]
)
def test_the_first_choices_are_possible_and_those_of_a_person_stay(held: frozenset[Stream]) -> None:
    first = choices_for(SlamChoices(), held)
    assert unsupported_reason(first, held) is None or not held & {"lidar", "depth"}
    if "lidar" in held and held & {"odometry", "tf"}:
        assert first == SlamChoices()
    elif unsupported_reason(first, held) is None:
        # A person may change one choice at a time, to each that is possible or not.
        for estimator in ESTIMATORS:
            own = first.model_copy(update={"estimator": estimator})
            assert choices_for(own, held) == own
