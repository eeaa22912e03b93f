"""CARMEN logs: angles, limits, clocks, poses, mounts, and what is lost by damage."""

import bz2
import gzip
import random
import shutil
import tracemalloc
from collections import defaultdict
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.errors import RecordingError
from fusion_core.recordings import archives
from fusion_core.recordings.carmen.lines import LaserDefaults, laser_scan, parse_line
from fusion_core.recordings.carmen.log import is_carmen_log, open_carmen_log
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.recorded_poses import recorded_poses

PACKINGS: dict[str, Callable[[bytes], bytes]] = {
    "plain": bytes,
    "gz": gzip.compress,
    "bz2": lambda text: bz2.compress(text, 1),
}
STAMPS = "100.5 host 1.5"


def flaser(
    readings: str = "1.0 2.0 3.0",
    laser: str = "0 0 0",
    robot: str = "0 0 0",
    stamps: str = STAMPS,
    keyword: str = "FLASER",
) -> str:
    return f"{keyword} {len(readings.split())} {readings} {laser} {robot} {stamps}"


def robotlaser(laser: str, robot: str, stamps: str = STAMPS, start: str = "-1.5") -> str:
    config = f"0 {start} 3.0 1.5 81.9 0.01 0"
    return f"ROBOTLASER1 {config} 3 1.0 2.0 3.0 0 {laser} {robot} 0 0 0 0 0 {stamps}"


class Log(NamedTuple):
    messages: list[Any]
    warnings: list[str]
    topics: dict[str, int]

    def of(self, topic: str) -> list[Any]:
        return [m for m in self.messages if m.topic == topic]


def read(path: Path) -> Log:
    with open_recording(path) as recording:
        messages = list(recording.messages())
        topics = {topic.name: topic.count for topic in recording.topics}
        return Log(messages, list(recording.warnings), topics)


@pytest.fixture
def log(tmp_path: Path) -> Callable[..., Log]:
    """What comes out of a log of these lines."""

    def from_lines(*lines: str, end: str = "\n") -> Log:
        file = tmp_path / "log"
        file.write_bytes(("\n".join(lines) + end).encode())
        return read(file)

    return from_lines


# The readings that CARMEN's SICK drivers log: an even number lacks the last beam.
ANGLES = [
    (180, None, -90.0, 89.0),
    (181, None, -90.0, 90.0),
    (360, None, -90.0, 89.5),
    (361, None, -90.0, 90.0),
    (400, None, -50.0, 49.75),
    (401, None, -50.0, 50.0),
    (181, 0.5, -45.0, 45.0),
    (541, 0.5, -135.0, 135.0),
    (682, 360 / 1024, -119.70703125, 119.70703125),
    (91, None, -90.0, 90.0),
    (1, None, 0.0, 0.0),
]


@pytest.mark.parametrize(("count", "resolution_deg", "first_deg", "last_deg"), ANGLES)
def test_angles_of_lines_without_angles(
    count: int, resolution_deg: float | None, first_deg: float, last_deg: float
) -> None:
    line = parse_line(flaser("1.0 " * count).encode())
    scan = laser_scan(line, None, "flaser", LaserDefaults(resolution_deg=resolution_deg))
    assert np.rad2deg(scan.angles_rad[[0, -1]]) == pytest.approx([first_deg, last_deg])


def test_unusual_counts_without_a_resolution_are_named(log: Callable[..., Log]) -> None:
    assert log(flaser("1.0 " * 180)).warnings == []
    (warning,) = log(flaser("1.0 " * 512)).warnings
    assert "512 readings" in warning
    with_resolution = log("PARAM laser_front_laser_resolution 0.5 host 0", flaser("1.0 " * 512))
    assert with_resolution.warnings == []


@given(
    ranges=st.lists(st.floats(allow_nan=True, width=64), min_size=1, max_size=50),
    stamp_us=st.integers(0, 2**50),
    logged_us=st.integers(-(10**9), 2**50),
)
def test_a_written_line_gives_its_numbers(
    ranges: list[float], stamp_us: int, logged_us: int
) -> None:
    stamps = [Decimal(us).scaleb(-6) for us in (stamp_us, logged_us)]
    text = flaser(" ".join(map(repr, ranges)), stamps=f"{stamps[0]:f} host {stamps[1]:f}")
    line = parse_line(text.encode())
    scan = laser_scan(line, line.received_ns, "flaser", LaserDefaults(1.0, 40.0))
    expected = [r if 0.0 < r < 40.0 else float("nan") for r in ranges]
    assert np.array_equal(scan.ranges_m, expected, equal_nan=True)
    assert (line.stamp_ns, line.received_ns) == (stamp_us * 1000, logged_us * 1000)


def test_error_codes_of_a_sick_are_no_returns(log: Callable[..., Log]) -> None:
    """81.83 m is one, whatever maximum range the line names; another laser may measure it."""
    config = "-1.5 3.0 1.5 81.9 0.01 0 3 81.82 81.83 81.91 0"
    found = log(f"RAWLASER1 0 {config} {STAMPS}", f"RAWLASER2 2 {config} {STAMPS}")
    sick, other = (found.of(f"/rawlaser{n}")[0].value for n in (1, 2))
    assert sick.ranges_m[0] == 81.82
    assert np.isnan(sick.ranges_m[1:]).all()
    assert other.ranges_m[:2].tolist() == [81.82, 81.83]
    assert np.isnan(other.ranges_m[2])
    assert other.angles_rad == pytest.approx([-1.5, 0.0, 1.5])


def test_remissions_that_do_not_match_are_left_out(log: Callable[..., Log]) -> None:
    config = "0 -1.5 3.0 1.5 81.9 0.01 0 3 1.0 2.0 3.0"
    found = log(f"RAWLASER1 {config} 3 7 8 9 {STAMPS}", f"RAWLASER1 {config} 2 7 8 {STAMPS}")
    matching, other = (m.value.intensities for m in found.of("/rawlaser1"))
    assert matching.tolist() == [7.0, 8.0, 9.0]
    assert other is None


def test_a_log_of_two_runs_is_in_the_order_of_its_log_time(log: Callable[..., Log]) -> None:
    times = ["0.5", "2.5", *["1.5"] * 40, "3.5"]
    lines = [flaser(stamps=f"{100 + i} host {time}") for i, time in enumerate(times)]
    found = log(*lines)
    scans = found.of("/flaser")
    assert [m.stamp_ns // 10**9 for m in scans] == [100, *range(102, 142), 101, 142]
    assert [m.received_ns for m in scans] == sorted(m.received_ns for m in scans)
    assert any("Steps back in log time: 1, first at line 3, by 1.0" in w for w in found.warnings)


@pytest.mark.parametrize("stamps", ["100.25", "100.25 host"])
def test_without_a_logger_the_ipc_stamps_order(log: Callable[..., Log], stamps: str) -> None:
    found = log(flaser(stamps="200 host"), flaser(stamps=stamps))
    scans = found.of("/flaser")
    assert [m.stamp_ns for m in scans] == [100_250_000_000, 200_000_000_000]
    assert [m.received_ns for m in scans] == [None, None]
    assert any("no logger timestamps" in warning for warning in found.warnings)


def test_a_line_without_logger_stamp_among_others(log: Callable[..., Log]) -> None:
    stamps = ["100 host 1", "101 host", "102 host 3.5", "103 host 4"]
    found = log(*(flaser(stamps=text) for text in stamps))
    # The median difference of the clocks is -99 s.
    assert [m.received_ns / 1e9 for m in found.of("/flaser")] == [1.0, 2.0, 3.5, 4.0]
    assert any("Lines without a logger timestamp: 1" in warning for warning in found.warnings)


def test_a_log_may_begin_before_its_zero(log: Callable[..., Log]) -> None:
    found = log(flaser(stamps="100 host -0.055208"), flaser(stamps="101 host 1"))
    assert found.of("/flaser")[0].received_ns == -55_208_000


def test_old_lines_may_lack_fields(log: Callable[..., Log]) -> None:
    """Without poses a scan is still a scan; without the last velocities a pose is a pose."""
    config = "0 -1.5 3.0 1.5 81.9 0.01 0 3 1.0 2.0 3.0 0"
    found = log(
        f"FLASER 3 1.0 2.0 3.0 {STAMPS}",
        f"ODOM 1 2 0.5 {STAMPS}",
        f"ROBOTLASER1 {config} 1.5 2 0.5 1.5 2 0.5 {STAMPS}",
    )
    assert found.topics == {
        "/flaser": 1,
        "/odom": 1,
        "/robotlaser1": 1,
        "/robotlaser1/odom": 1,
        "/tf_static": 1,
    }
    assert len(found.messages) == 5


@pytest.mark.parametrize(
    ("lines", "end"),
    [
        ("\r\n".join(flaser(stamps=f"{100 + i} host {i}") for i in range(4)), "\r\n"),
        ("\n".join(flaser(stamps=f"{100 + i} host {i}") for i in range(4)), ""),
        ("\n\n# x\n".join(flaser(stamps=f"{100 + i} host {i}") for i in range(4)), "\n \n"),
        ("\n".join("  " + flaser(stamps=f"{100 + i}\thost  {i}") for i in range(4)), "\n"),
    ],
)
def test_line_ends_and_spaces(log: Callable[..., Log], lines: str, end: str) -> None:
    found = log(lines, end=end)
    assert found.topics == {"/flaser": 4, "/flaser/odom": 4}
    assert len(found.warnings) == 1
    assert "angles" in found.warnings[0]


def mounted(found: Log) -> dict[str, np.ndarray]:
    return {t.child: t.T_parent_child for m in found.of("/tf_static") for t in m.value.transforms}


def test_the_mount_is_the_laser_pose_on_the_robot(tmp_path: Path) -> None:
    """And joins scans to odometry: the laser turned left of a robot that drives and turns."""
    file = tmp_path / "log"
    half = np.pi / 2
    poses = [("1.0 2.0 0.5", "1.0 1.0 0.0"), (f"-1.0 1.0 {half + 0.5}", f"0.0 1.0 {half}")]
    lines = [
        robotlaser(laser, robot, stamps=f"{100 + i} host {i}")
        for i, (laser, robot) in enumerate(poses)
    ]
    file.write_text("\n".join(lines))
    with open_recording(file) as recording:
        assert {t.name for t in recording.topics} == {
            "/robotlaser1",
            "/robotlaser1/odom",
            "/tf_static",
        }
        streams = choose_streams(recording)
        found = recorded_poses(recording, streams, "robotlaser1")
    assert found is not None
    assert found.source == "/robotlaser1/odom"
    for i, expected in enumerate([(1.0, 2.0, 0.5), (-1.0, 1.0, half + 0.5)]):
        assert found.at((100 + i) * 10**9) == pytest.approx(expected)


def test_a_changing_laser_pose_is_no_mount(log: Callable[..., Log]) -> None:
    found = log(
        robotlaser("0.25 0 0", "0 0 0", "100 h 1"), robotlaser("1.5 0 0", "1 0 0", "101 h 2")
    )
    assert mounted(found) == {}
    pose = found.of("/robotlaser1/pose")[1].value
    assert (pose.parent, pose.child) == ("map", "robotlaser1")
    assert pose.T_parent_child[:2, 3].tolist() == [1.5, 0.0]


def test_the_mount_of_an_old_front_laser_is_a_parameter(log: Callable[..., Log]) -> None:
    scan = flaser(laser="1.25 0 0", robot="1 0 0")
    offset = "PARAM robot_frontlaser_offset 0.25 nohost 0"
    side = "PARAM robot_frontlaser_side_offset -0.5 nohost 0"
    turned = "PARAM robot_frontlaser_angular_offset 0.5 nohost 0"
    assert mounted(log(scan)) == {}
    assert log(scan).topics == {"/flaser": 1, "/flaser/odom": 1, "/flaser/pose": 1}
    with_offset = log(offset, scan)
    assert mounted(with_offset)["flaser"][:3, 3].tolist() == [0.25, 0.0, 0.0]
    assert "/flaser/pose" not in with_offset.topics
    # A parameter counts wherever it is in the log.
    assert mounted(log(scan, offset, side))["flaser"][:3, 3].tolist() == [0.25, -0.5, 0.0]
    assert mounted(log(offset, turned, scan)) == {}


def test_ground_truth_is_never_taken_for_odometry(log: Callable[..., Log], tmp_path: Path) -> None:
    log(flaser(), f"TRUEPOS 5 6 0.5 1 2 0.25 {STAMPS}")
    with open_recording(tmp_path / "log") as recording:
        streams = choose_streams(recording)
        truth = recording.read("/truepos/ground_truth", 0).value
    assert (streams.odometry, streams.pose) == ("/flaser/odom", None)
    assert truth.T_parent_child[:2, 3].tolist() == [5.0, 6.0]


DAMAGED = {
    "FLASER 1000000000 1.0 2.0": "claims 1000000000 readings and has 2 fields left",
    f"FLASER -3 1.0 2.0 3.0 0 0 0 0 0 0 {STAMPS}": "'-3' for its number of readings",
    f"FLASER 3e0 1.0 2.0 3.0 0 0 0 0 0 0 {STAMPS}": "'3e0' for its number",
    "FLASER " + "9" * 5000 + " 1.0": "for its number of readings",
    "FLASER": "ends before its number of readings",
    flaser("1.0 2.0 3.0")[: -len(STAMPS)]: "no timestamps",
    flaser() + " " + flaser(): "fields too many",
    flaser(stamps="nan host 1"): "'nan' for its ipc timestamp",
    flaser(stamps="inf host 1"): "'inf' for its ipc timestamp",
    flaser(stamps="1e999999999 host 1"): "ipc timestamp",
    flaser(stamps="-5 host 1"): "'-5' for its ipc timestamp",
    flaser(stamps="5 host 1e30"): "'1e30' for its logger timestamp",
    flaser(stamps="5 host --1"): "'-1' for its logger timestamp",
    flaser(laser="nan 0 0"): "'nan' in its pose",
    flaser(robot="0 inf 0"): "'inf' in its pose",
    flaser(robot="0 -1e300 0"): "a pose 1e+300 m away",
    f"ODOM 1 x 0 0 0 0 {STAMPS}": "'x' in its pose",
    f"ODOM 1 2 {STAMPS}": "2 fields where a pose should end",
    "ROBOTLASER1 0 -1.5 3.0": "ends before its number of readings",
    "RAWLASER1 0 -1.5 3.0 1.5 80 0.01 0 1 1.0 7 5": "claims 7 remissions and has 1",
    "PARAM robot_front_laser_max far host 0": "no number for robot_front_laser_max",
    "\0\0\0\xff": "begins with no message of CARMEN",
    "X" * (1 << 21): "longer than 1048576 bytes",
}


@pytest.mark.parametrize("line", DAMAGED, ids=range(len(DAMAGED)))
def test_a_damaged_line_loses_only_itself(log: Callable[..., Log], line: str) -> None:
    whole = [flaser("1.0 " * 181, stamps=f"{100 + i} host {i}") for i in range(4)]
    found = log(*whole[:2], line, *whole[2:])
    assert found.topics == {"/flaser": 4, "/flaser/odom": 4}
    (warning,) = found.warnings
    assert "Damaged lines left out: 1 (" in warning
    assert "from 1.000000 s to 2.000000 s of the log; the first: line 3" in warning
    assert DAMAGED[line] in warning
    assert len(warning) < 300


UNDECODABLE = {
    flaser("1.0 abc 3.0"): "'abc' among its readings",
    flaser("1.0 2.0\0 3.0"): "among its readings",
    "RAWLASER1 0 -1.5 3.0 0 80 0.01 0 1 1.0 0 5 h 1": "angular resolution of 0",
    "RAWLASER1 0 nan 3.0 1 80 0.01 0 1 1.0 0 5 h 1": "'nan' in its configuration",
    "RAWLASER1 0 -1.5 3.0 100 80 0.01 0 2 1.0 1.0 0 5 h 1": "over 2 beams spans 15.92 turns",
    "RAWLASER1 0 -1.5 3.0 1 -80 0.01 0 1 1.0 0 5 h 1": "maximum range of -80 m",
    "RAWLASER1 0 -1.5 3.0 1 80 0.01 0 0 0 5 h 1": "no readings",
}


@pytest.mark.parametrize("line", UNDECODABLE, ids=range(len(UNDECODABLE)))
def test_a_scan_that_cannot_be_decoded_loses_only_itself(
    log: Callable[..., Log], line: str
) -> None:
    found = log(flaser(), line)
    topic = "/" + line.split()[0].lower()
    scans = found.of(topic)
    assert len(scans) == found.topics[topic] - 1
    assert any(
        "1 of" in warning and UNDECODABLE[line] in warning and "\n" not in warning
        for warning in found.warnings
    )


def test_messages_of_other_kinds_are_named(log: Callable[..., Log]) -> None:
    found = log(flaser("1.0 " * 180), "NMEA-GGA 1 2 3", "SONAR 1", "SONAR 2", "SYNC tag 1 h 1")
    assert found.warnings == ["Messages of these kinds are left out: NMEA-GGA (1), SONAR (2)."]


def test_a_log_of_other_kinds_alone(log: Callable[..., Log]) -> None:
    with pytest.raises(RecordingError, match=r"without messages that can be read.*SONAR \(1\)"):
        log("PARAM robot_length 0.5 nohost 0", "SONAR 1 2 3")


TEXTS = [
    "976052905.16 976052911.88 -0.05 -0.12 0.0 0.0 0.0 -1.68\n",
    "FLASERS are lasers\n",
    "ODOM is short for odometry\n",
    "PARAM name value\n",
    "# FLASER 3 1 2 3\n",
    "word\n" * 10 + flaser() + "\n",
]


@pytest.mark.parametrize("packing", PACKINGS)
@pytest.mark.parametrize("text", TEXTS)
def test_other_texts_are_no_logs(tmp_path: Path, text: str, packing: str) -> None:
    file = tmp_path / "log.clf"
    file.write_bytes(PACKINGS[packing](text.encode()))
    assert not is_carmen_log(file)
    with pytest.raises(RecordingError, match="is no recording"):
        open_recording(file)


def test_a_long_head_of_comments(tmp_path: Path) -> None:
    file = tmp_path / "log"
    file.write_text("# PARAM and other names\n" * 2000 + flaser() + "\n")
    assert is_carmen_log(file)


def test_memory_is_bounded_by_the_longest_line_allowed(tmp_path: Path) -> None:
    file = tmp_path / "log"
    with file.open("wb") as out:
        out.write(flaser().encode() + b"\nFLASER 180 ")
        out.truncate(64 << 20)
        out.seek(0, 2)
        out.write(b"\n" + flaser().encode())
    tracemalloc.start()
    try:
        found = read(file)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert found.topics["/flaser"] == 2
    assert peak < 8 << 20


def many_scans(count: int) -> bytes:
    generator = np.random.default_rng(3)
    ranges = generator.uniform(0.5, 30.0, (count, 181))
    lines = (
        flaser(" ".join(f"{r:.2f}" for r in row), stamps=f"{1000 + i}.250000 host {i}.125000")
        for i, row in enumerate(ranges)
    )
    return ("\n".join(lines) + "\n").encode()


# Scans that must survive of 600, cut at a fraction of the bytes: gzip loses what its decoder
# buffers, bzip2 the block of 100 kB that is cut.
LEAST = {"plain": (299, 593), "gz": (225, 560), "bz2": (225, 500)}


@pytest.mark.parametrize("packing", PACKINGS)
def test_a_truncated_log_gives_what_precedes_the_cut(tmp_path: Path, packing: str) -> None:
    whole = PACKINGS[packing](many_scans(600))
    file = tmp_path / "cut"
    for fraction, least in zip((0.5, 0.99), LEAST[packing], strict=True):
        file.write_bytes(whole[: int(len(whole) * fraction)])
        found = read(file)
        scans = found.of("/flaser")
        assert least <= len(scans) < 600
        assert [m.received_ns for m in scans] == [
            i * 10**9 + 125_000_000 for i in range(len(scans))
        ]
        if packing == "plain":
            assert "breaks off" in found.warnings[0] or "Damaged lines" in found.warnings[0]
        else:
            last = f"What follows {len(scans) - 1}.125000 s of the log is lost"
            assert last in found.warnings[0]
            assert "breaks off after" in found.warnings[0]


def test_the_last_line_is_left_out_where_a_number_is_cut(log: Callable[..., Log]) -> None:
    lines = [flaser("1.0 " * 180, stamps=f"{100 + i}.5 host {20 + i}.5") for i in range(3)]
    for cut in range(len(STAMPS) + 4):
        text = "\n".join(lines)
        found = log(text[: len(text) - cut], end="")
        times = [m.received_ns / 1e9 for m in found.of("/flaser")]
        # A time without its decimals still lies between its neighbours.
        assert times[:2] == [20.5, 21.5]
        assert all(21.5 < time <= 22.5 for time in times[2:])
        assert len(times) == 3 or "the first: line 3" in found.warnings[0]


@pytest.mark.parametrize("packing", PACKINGS)
def test_mutated_logs_give_a_warning_or_are_refused(
    tmp_path: Path, carmen_logs: Any, packing: str
) -> None:
    """Flipped, removed and repeated bytes, cuts: nothing but RecordingError."""
    whole = PACKINGS[packing](carmen_logs.small_log(12)[0].encode())
    generator = random.Random(11)
    file = tmp_path / "mutated"
    refusals: list[str] = []
    for number in range(200):
        data = bytearray(whole)
        for _ in range(generator.randint(1, 4)):
            place = generator.randrange(len(data))
            end = min(len(data), place + generator.randint(1, 30))
            match number % 4:
                case 0:
                    data[place] ^= 1 << generator.randrange(8)
                case 1:
                    data[place:end] = generator.randbytes(end - place)
                case 2:
                    data[end:end] = data[place:end] * 3
                case _:
                    del data[place:end]
        file.write_bytes(data if number % 5 else data[: generator.randrange(len(data))])
        try:
            read(file)
        except RecordingError as error:
            refusals.append(str(error))
    # A flipped bit loses its whole bzip2 block, and this log has only one.
    assert len(refusals) <= {"plain": 20, "gz": 120, "bz2": 200}[packing]
    assert not any("\n" in refusal for refusal in refusals)


def test_an_archive_that_unpacks_without_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archives, "_SMALLEST_LIMIT_BYTES", 1 << 20)
    file = tmp_path / "bomb.gz"
    file.write_bytes(gzip.compress((flaser() + "\n").encode() + bytes(8 << 20)))
    found = read(file)
    assert found.topics["/flaser"] == 1
    assert (
        "What follows 1.500000 s of the log is lost: the archive unpacks to more"
        in (found.warnings[0])
    )


def test_a_full_disk_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "log.gz"
    file.write_bytes(gzip.compress((flaser() + "\n").encode()))
    usage = shutil.disk_usage(tmp_path)._replace(free=1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    with pytest.raises(RecordingError, match="the disk of temporary files has room for no more"):
        open_recording(file)


def test_parts_packed_one_after_the_other(tmp_path: Path) -> None:
    for pack in (gzip.compress, bz2.compress):
        file = tmp_path / "parts"
        parts = [flaser("1.0 " * 180, stamps=f"{100 + i} host {i}") + "\n" for i in range(3)]
        file.write_bytes(b"".join(pack(part.encode()) for part in parts))
        found = read(file)
        assert (found.topics["/flaser"], found.warnings) == (3, [])


def test_a_log_that_shrinks_while_it_is_open(tmp_path: Path) -> None:
    file = tmp_path / "log"
    file.write_text("\n".join(flaser(stamps=f"{100 + i} host {i}") for i in range(9)) + "\n")
    with open_carmen_log(file) as recording:
        file.write_text("# nothing\n")
        with pytest.raises(RecordingError, match="no longer what it was"):
            recording.read("/flaser", 5)


REAL = {
    "intel.clf.bz2": {"FLASER": 13_631, "ODOM": 26_915},
    "mit-csail.clf.bz2": {"FLASER": 1_988},
    "fr-clinic_robotlaser.clf.bz2": {"ROBOTLASER1": 6_917},
}


@pytest.mark.data
@pytest.mark.parametrize(
    "name",
    # The longest has no line of a kind that the others lack.
    [pytest.param(name, marks=[pytest.mark.slow] * (name == "intel.clf.bz2")) for name in REAL],
)
def test_real_logs_line_by_line(data_folder: Path, name: str) -> None:
    """Every line split by hand."""
    file = data_folder / "real/carmen" / name
    lines = defaultdict(list)
    for text in bz2.decompress(file.read_bytes()).decode().splitlines():
        fields = text.split()
        if fields[0] in REAL[name]:
            lines[fields[0]].append(fields)
    with open_recording(file) as recording:
        for keyword, expected in lines.items():
            expected.sort(key=lambda fields: Decimal(fields[-1]))
            found = list(recording.messages([f"/{keyword.lower()}"]))
            assert len(found) == len(expected) == REAL[name][keyword]
            for message, fields in zip(found, expected, strict=True):
                clocks = (message.stamp_ns, message.received_ns)
                assert clocks == tuple(int(Decimal(fields[i]) * 10**9) for i in (-3, -1))
                if keyword == "ODOM":
                    assert message.value.T_parent_child[:2, 3].tolist() == [
                        float(field) for field in fields[1:3]
                    ]
                    continue
                start = 8 if keyword == "ROBOTLASER1" else 1
                count = int(fields[start])
                ranges = np.array(fields[start + 1 : start + 1 + count], dtype=np.float64)
                ranges[(ranges >= 81.83) | (ranges <= 0.0)] = np.nan
                assert np.array_equal(message.value.ranges_m, ranges, equal_nan=True)


@pytest.mark.data
def test_mounts_of_real_logs(data_folder: Path) -> None:
    expected = {
        "intel.clf.bz2": [0.0, 0.0, 0.0],
        "mit-csail.clf.bz2": None,
        "fr-clinic_robotlaser.clf.bz2": [0.22, 0.0, 0.0],
    }
    for name, offset_m in expected.items():
        with open_recording(data_folder / "real/carmen" / name) as recording:
            names = {topic.name for topic in recording.topics}
            static = [m.value for m in recording.messages(names & {"/tf_static"})]
        assert not any(topic.endswith("/pose") for topic in names)
        if offset_m is None:
            assert static == []
        else:
            (mount,) = static[0].transforms
            assert mount.T_parent_child[:3, 3] == pytest.approx(offset_m, abs=1e-4)
