"""Recordings whose scans are without ranges, or have beams and angles that no scanner has."""

import tracemalloc
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fusion_core.evaluation.fuse_folder import open_fuse_folder
from fusion_core.model.errors import AlignmentFailed, MissingStream, RecordingError, ScanLoomError
from fusion_core.model.progress import silent
from fusion_core.model.slam_view import no_observer
from fusion_core.recordings.decode import decode_message
from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.options import MapOptions
from scanloom.jobs.slam_run import SlamRequest, run_slam
from scanloom.state.slam_choices import SlamChoices
from scanloom.state.view import View
from tests.hostile.scans import (
    CAMERAS,
    IMPLAUSIBLE,
    ODD,
    SCAN_TOPIC,
    SCANS,
    WITHOUT_RANGES,
    Change,
    every_scan,
    scans_where,
    write_room,
)

Run = Callable[[Path, Path], tuple[str, ...]]


def run_fuse(recording: Path, output: Path) -> tuple[str, ...]:
    return fuse(recording, output, FuseOptions(maps=False, figures=False)).notes


def run_map(recording: Path, output: Path) -> tuple[str, ...]:
    report = build_map(recording, output, MapOptions(slam="none", motion="laser")).report
    return tuple(report["notes"])


RUNS = pytest.mark.parametrize("run", [run_fuse, run_map])


@RUNS
def test_a_scan_without_ranges_costs_itself(tmp_path: Path, run: Run) -> None:
    recording = write_room(tmp_path / "room.mcap", WITHOUT_RANGES["first_empty"])
    notes = run(recording, tmp_path / "results")
    (told,) = [note for note in notes if "left out" in note]
    assert told.startswith(f"{SCAN_TOPIC}: 1 of {SCANS} messages are left out")
    assert "the scan has no ranges" in told


@RUNS
@pytest.mark.parametrize(
    ("change", "named"),
    [
        (WITHOUT_RANGES["all_empty"], "the scan has no ranges"),
        (IMPLAUSIBLE["increment_100"], "angle_increment 100 rad over 360 beams spans 5714 turns"),
        (IMPLAUSIBLE["beams_100000"], "the scan claims 100000 beams"),
    ],
)
def test_without_any_scan_the_recording_is_refused_by_name(
    tmp_path: Path, run: Run, change: Change, named: str
) -> None:
    recording = write_room(tmp_path / "room.mcap", change)
    with pytest.raises(MissingStream, match=named) as caught:
        run(recording, tmp_path / "results")
    assert caught.value.file == str(recording)
    assert caught.value.advice
    assert f"{SCAN_TOPIC} holds no scan that can be read" in str(caught.value)
    assert f"the first of its {SCANS} messages" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_workbench_tells_a_run_without_any_scan_as_failed(tmp_path: Path) -> None:
    recording = write_room(tmp_path / "room.mcap", WITHOUT_RANGES["all_empty"])
    view = View(recording=recording.name, slam=SlamChoices())
    root = tmp_path / "runs"
    root.mkdir()
    request = SlamRequest(number=1, view=view, recording=recording)
    with pytest.raises(ScanLoomError, match="the scan has no ranges"):
        run_slam(request, root, silent, no_observer)
    assert not list(root.iterdir())


@pytest.mark.parametrize("name", [name for name in IMPLAUSIBLE if "beams" not in name])
def test_sweeps_that_no_scanner_makes_cost_themselves(tmp_path: Path, name: str) -> None:
    with open_recording(write_room(tmp_path / "room.mcap", IMPLAUSIBLE[name])) as recording:
        assert not list(recording.messages([SCAN_TOPIC]))
        (warning,) = recording.warnings
        assert f"{SCANS} of {SCANS} messages are left out" in warning


@pytest.mark.parametrize("name", ODD)
def test_what_a_scanner_may_send_is_read(tmp_path: Path, name: str) -> None:
    with open_recording(write_room(tmp_path / "room.mcap", ODD[name])) as recording:
        assert len(list(recording.messages([SCAN_TOPIC]))) == SCANS
        assert not recording.warnings


def test_a_scan_of_millions_of_beams_takes_no_memory() -> None:
    beams = 16_000_000
    raw = SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=0), frame_id="laser"),
        angle_min=0.0,
        angle_increment=0.01,
        time_increment=0.0,
        scan_time=0.1,
        range_min=0.1,
        range_max=10.0,
        # As many values as are claimed, in the memory of one.
        ranges=np.broadcast_to(np.float32(2.0), beams),
        intensities=np.zeros(0, dtype=np.float32),
    )
    tracemalloc.start()
    try:
        with pytest.raises(RecordingError, match="/scan: the scan claims 16000000 beams"):
            decode_message(raw, "sensor_msgs/msg/LaserScan", topic="/scan", received_ns=None)
        assert tracemalloc.get_traced_memory()[1] < beams
    finally:
        tracemalloc.stop()


def test_scans_that_met_nothing_cannot_be_aligned(tmp_path: Path) -> None:
    recording = write_room(tmp_path / "room.mcap", ODD["all_inf"])
    with pytest.raises(AlignmentFailed, match="no scan that is paired with a depth image has a"):
        run_fuse(recording, tmp_path / "results")


@pytest.mark.parametrize("name", ["one_beam", "full_turn_and_a_step", "beams_change"])
@pytest.mark.parametrize("slam", ["pose-graph", "particle-filter"])
def test_odd_sweeps_are_mapped_or_refused(tmp_path: Path, name: str, slam: str) -> None:
    recording = write_room(tmp_path / "room.mcap", ODD[name])
    options = MapOptions(slam=slam, motion="laser")
    if name == "one_beam":
        with pytest.raises(ScanLoomError, match="of the scans fit the map"):
            build_map(recording, tmp_path / "results", options)
    else:
        assert build_map(recording, tmp_path / "results", options).report["trusted_share"] == 1.0


def test_an_unlimited_range_is_kept_in_the_results(tmp_path: Path) -> None:
    recording = write_room(tmp_path / "room.mcap", ODD["range_max_inf"])
    run_fuse(recording, tmp_path / "results")
    assert open_fuse_folder(tmp_path / "results").lidar.range_max_m == np.inf


@pytest.mark.parametrize(
    ("name", "named"),
    [
        ("distortion_1e300", "the distortion coefficient 1e+300 is larger than 1e+09"),
        ("focal_1e-300", "the focal length fx 1e-300 lies outside 0.01 to 1e+06 pixels"),
        ("mount_1e300", "position 1e+300 0.0 0.3 lies farther than 1e+08 m"),
    ],
)
def test_cameras_and_mounts_that_cannot_be_are_named(tmp_path: Path, name: str, named: str) -> None:
    """Warnings of numpy are errors here."""
    recording = write_room(tmp_path / "room.mcap", CAMERAS[name])
    assert any(named in note for note in run_fuse(recording, tmp_path / "results"))


def test_a_single_hostile_scan_changes_nothing_else(tmp_path: Path) -> None:
    """The others are mapped as if the scan had not been there."""
    wide = scans_where(lambda number: number == 7, angle_increment=100.0)
    empty = scans_where(lambda number: number == 7, ranges=np.zeros(0, dtype=np.float32))
    for name, change in {"wide": wide, "empty": empty}.items():
        run_map(write_room(tmp_path / f"{name}.mcap", change), tmp_path / name)
    ways = [(tmp_path / name / "trajectory.tum").read_text() for name in ("wide", "empty")]
    assert ways[0] == ways[1]
    assert len(ways[0].splitlines()) == SCANS, "a line of names, and a pose for each other scan"


def test_the_recording_without_a_change_is_sound(tmp_path: Path) -> None:
    with open_recording(write_room(tmp_path / "room.mcap", every_scan())) as recording:
        assert all(topic.count for topic in recording.topics)
        assert len(list(recording.messages())) == sum(topic.count for topic in recording.topics)
        assert not recording.warnings
