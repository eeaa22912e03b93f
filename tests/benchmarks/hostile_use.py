"""What hostile use makes of the commands and of the workbench: a row for each attack.

    python -m tests.benchmarks.hostile_use [--only 3 16]

Each row has the command, its exit code, seconds, its greatest memory, and its notes and last line;
under it the tests that hold it. Commands run in processes of their own, which inherit the memory
of this one (some 300 MiB) as their least, on recordings that are built here. Exits with 1 where a
command ends in a traceback, or by anything but 0, 1 or 2.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.benchmarks import hostile_visits as visits
from tests.hostile.bags import write_bag_of_renamed_topic, write_flipped_mcap, write_old_bag
from tests.hostile.drive import write_drive
from tests.hostile.files import write_loop, write_pipe
from tests.hostile.mounts import moved_mount
from tests.hostile.names import NO_UTF8
from tests.hostile.outliers import far_poses, far_ranges
from tests.hostile.scans import HOSTILE, write_room
from tests.hostile.settings import NUMBERS, write_number, write_swapped_ends, write_wide_search
from tests.hostile.stamps import backwards, one_ahead
from tests.workflows.box_recording import write_boxes

ROOT = Path(__file__).parents[2]
MOST_SECONDS = 300.0
MIB = 1 << 20
_SHOWN = 300
_TOLD = ("note", "warning", "checked", "scans ")
NOBODY = 65534


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How a process ended."""

    code: int
    seconds: float
    peak_mib: float
    output: str

    @property
    def said(self) -> list[str]:
        """The notes and warnings, and the last line."""
        *before, last = self.output.strip().splitlines() or [""]
        return [*(line for line in before if line.startswith(_TOLD)), last]


@dataclass(frozen=True, kw_only=True)
class Row:
    """One attack: what is called in an empty folder, and the tests that hold it."""

    what: str
    calls: Callable[[Path], Iterator[tuple[str, Ended]]]
    tests: Sequence[str]
    codes: Sequence[int] = (0, 1, 2)


def run(
    words: Sequence[str | Path],
    *,
    env: dict[str, str] | None = None,
    user: int | None = None,
    cwd: Path | None = None,
    end_after: str = "",
) -> Ended:
    """Run ``scanloom`` and measure it; SIGTERM is sent once it has said ``end_after``."""
    begun = _clock_s()
    process = subprocess.Popen(
        [sys.executable, "-m", "scanloom", *words],
        cwd=cwd,
        env=(dict(os.environ) if env is None else env) | {"PYTHONPATH": str(ROOT)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        user=user,
        group=user,
        extra_groups=None if user is None else [],
    )
    alarm = threading.Timer(MOST_SECONDS, process.kill)
    alarm.start()
    assert process.stdout is not None
    said = []
    for line in process.stdout:
        said.append(line.decode(errors="backslashreplace"))
        if end_after and end_after in said[-1]:
            process.send_signal(signal.SIGTERM)
    _, status, usage = os.wait4(process.pid, 0)
    alarm.cancel()
    return Ended(
        code=os.waitstatus_to_exitcode(status),
        seconds=_clock_s() - begun,
        peak_mib=usage.ru_maxrss * 1024 / MIB,
        output="".join(said),
    )


def _clock_s() -> float:
    return os.times().elapsed


Call = tuple[str, Ended]


def visited(
    calls: Callable[[Path], Iterator[tuple[str, float, float, str]]], folder: Path
) -> Iterator[Call]:
    """Visits of the workbench, in the form of calls."""
    for call, seconds, peak_mib, happened in calls(folder):
        yield call, Ended(code=0, seconds=seconds, peak_mib=peak_mib, output=happened)


def called(*words: str | Path) -> Call:
    """A command as it is called, and how it ended."""
    frame_view = [word.name if isinstance(word, Path) else word for word in words]
    return f"scanloom {' '.join(frame_view)}", run(words)


def inputs_kept(folder: Path) -> Iterator[Call]:
    room = folder / "room.mcap"
    write_boxes(room, duration_s=0.4)
    fused = folder / "g" / "fused.mcap"
    yield called("fuse", room, "-o", folder / "g", "--no-figures")
    before = fused.read_bytes()
    yield called("map", fused, "-o", folder / "g", "--motion=none")
    yield called("fuse", fused, "-o", folder / "g")
    yield called("fuse", fused, "-o", folder / "g", "--overwrite", "--force")
    assert fused.read_bytes() == before
    (folder / "h").mkdir()
    (folder / "h" / "fused.mcap").write_bytes(b"foreign")
    yield called("fuse", room, "-o", folder / "h", "--overwrite", "--no-figures")
    assert (folder / "h" / "fused.mcap").read_bytes() == b"foreign"


def one_kind(folder: Path) -> Iterator[Call]:
    room = folder / "room.mcap"
    write_boxes(room, duration_s=0.4)
    yield called("fuse", room, "-o", folder / "x", "--no-figures")
    yield called("map", room, "-o", folder / "x", "--motion=none")


def scans(
    *names: str, commands: Sequence[str] = ("fuse", "map")
) -> Callable[[Path], Iterator[Call]]:
    def calls(folder: Path) -> Iterator[Call]:
        for name in names:
            recording = write_room(folder / f"{name}.mcap", HOSTILE[name])
            for command in commands:
                yield called(command, recording, "-o", folder / f"{command}-{name}")

    return calls


def times(folder: Path) -> Iterator[Call]:
    for name, write in (("ahead", one_ahead), ("backwards", backwards)):
        write(folder / f"{name}.mcap")
        for command in ("map", "fuse"):
            yield called(command, folder / f"{name}.mcap", "-o", folder / f"{command}-{name}")


def wide_settings(folder: Path) -> Iterator[Call]:
    room = folder / "room.mcap"
    write_boxes(room, duration_s=0.4)
    far = write_number(folder / "far.toml", NUMBERS["far"])
    yield called("fuse", room, "-o", folder / "o", "--settings", far)
    wide = write_wide_search(folder / "wide.toml")
    yield called("map", room, "-o", folder / "o", "--settings", wide)
    yield from visited(visits.endless_links, folder)


def two_at_once(folder: Path) -> Iterator[Call]:
    room = folder / "room.mcap"
    write_boxes(room, duration_s=2.0)
    ended: list[Call] = []

    def work() -> None:
        ended.append(called("fuse", room, "-o", folder / "o"))

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    yield from ended


def nobodys_home(folder: Path) -> Iterator[Call]:
    room = folder / "room.mcap"
    write_drive(room)
    folder.chmod(0o777)
    # Where nobody may run this Python, it stays with who calls.
    try:
        ended = subprocess.run(
            [sys.executable, "-V"],
            capture_output=True,
            user=NOBODY,
            group=NOBODY,
            extra_groups=[],
        )
        may_run = ended.returncode == 0
    except PermissionError:
        may_run = False
    user = NOBODY if may_run else None
    env = {"PATH": os.environ["PATH"]}
    who = f"without HOME, as {'nobody' if may_run else 'the same user'}"
    for command in ("fuse", "map"):
        words = [command, room, "-o", folder / command]
        yield f"{command} {who}", run(words, env=env, user=user, cwd=folder)
    words = ["view", room, "--port=0"]
    yield f"view {who}", run(words, env=env, user=user, cwd=folder, end_after="http://")


def old_bag(folder: Path) -> Iterator[Call]:
    yield called("info", write_old_bag(folder / "old.bag"))


def names(folder: Path) -> Iterator[Call]:
    odd = folder / NO_UTF8
    odd.mkdir()
    room = odd / f"{NO_UTF8}.mcap"
    write_drive(folder / "room.mcap")
    (folder / "room.mcap").rename(room)
    for command in ("fuse", "map"):
        yield f"{command} r\\xff.mcap -o o\\xff", run([command, room, "-o", odd / command])
    yield "view r\\xff.mcap", run(["view", room, "--port=0"], end_after="http://")


def mounts(folder: Path) -> Iterator[Call]:
    moved_mount(folder / "far.mcap", forward_m=1e6)
    yield called("fuse", folder / "far.mcap", "-o", folder / "o", "--no-figures")


def outliers(folder: Path) -> Iterator[Call]:
    for name, write in (("ranges", far_ranges), ("poses", far_poses)):
        write(folder / f"{name}.mcap")
        for command in ("fuse", "map"):
            yield called(command, folder / f"{name}.mcap", "-o", folder / f"{command}-{name}")


def ports(folder: Path) -> Iterator[Call]:
    for port in ("99999", "-1"):
        yield called("view", f"--port={port}")


def flipped(folder: Path) -> Iterator[Call]:
    write_flipped_mcap(folder / "flipped.mcap", 0.5)
    yield called("info", folder / "flipped.mcap")
    yield called("info", folder / "flipped.mcap", "--check")


def numbers(folder: Path) -> Iterator[Call]:
    room = folder / "room.mcap"
    write_boxes(room, duration_s=0.4)
    for number, (name, digits) in enumerate(NUMBERS.items()):
        file = write_number(folder / f"{number}.toml", digits)
        yield (
            f"fuse --settings, delta_z_min_m {name}",
            run(["fuse", room, "-o", folder / "o", "--settings", file]),
        )
    swapped = write_swapped_ends(folder / "swapped.toml")
    yield called("fuse", room, "-o", folder / "o", "--settings", swapped)


def options(folder: Path) -> Iterator[Call]:
    room = folder / "room.mcap"
    write_boxes(room, duration_s=0.4)
    for value in ("inf", "1e300", "nan"):
        yield called("map", room, "-o", folder / "o", f"--clock-offset-ms={value}")
    yield "scanloom info /", run(["info", "/"])
    yield called("fuse", room, "-o", write_loop(folder / "loop"))


def devices(folder: Path) -> Iterator[Call]:
    room = folder / "room.mcap"
    write_boxes(room, duration_s=0.4)
    for file in (Path("/dev/zero"), write_pipe(folder / "pipe")):
        yield called("fuse", room, "-o", folder / "o", "--settings", file)
    yield "scanloom info /dev", run(["info", "/dev"])


def terminated(folder: Path) -> Iterator[Call]:
    room = folder / "room.mcap"
    write_boxes(room, duration_s=2.0)
    out = folder / "o"
    yield "fuse, SIGTERM while it works", run(["fuse", room, "-o", out], end_after="matching scans")
    assert not out.exists()


def renamed(folder: Path) -> Iterator[Call]:
    yield called("info", write_bag_of_renamed_topic(folder / "renamed.bag"))


def advice(folder: Path) -> Iterator[Call]:
    room = folder / "room.mcap"
    write_drive(room)
    yield called("map", room, "-o", folder / "o", "--motion=visual")
    depth = "--depth=/camera/depth/image_raw"
    yield called("fuse", room, "-o", folder / "o", depth, depth)
    coarse = folder / "fine.toml"
    coarse.write_text("[grid]\nresolution_m = 0.001\ncells_max = 1000000000\n")
    yield called("fuse", room, "-o", folder / "o", "--settings", coarse)
    far = write_room(folder / "far.mcap", HOSTILE["distortion_1e300"])
    yield called("fuse", far, "-o", folder / "o")
    yield from visited(visits.malformed, folder)


def silent_sockets(folder: Path) -> Iterator[Call]:
    yield from visited(visits.silent_sockets, folder)


def odd_links(folder: Path) -> Iterator[Call]:
    yield from visited(visits.odd_links, folder)


def killed(folder: Path) -> Iterator[Call]:
    """A few of the kills; ``tests.benchmarks.kills`` does them by the hundred."""
    begun = _clock_s()
    words = [sys.executable, "-m", "tests.benchmarks.kills", "--kills", "12"]
    ended = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    yield (
        "python -m tests.benchmarks.kills --kills 12",
        Ended(
            code=ended.returncode,
            seconds=_clock_s() - begun,
            peak_mib=float("nan"),
            output=ended.stdout + ended.stderr,
        ),
    )


ROWS = {
    1: Row(
        what="a recording among the results",
        calls=inputs_kept,
        tests=["hostile/test_inputs_are_kept.py"],
    ),
    2: Row(
        what="two commands into one folder",
        calls=one_kind,
        tests=["exporting/test_output_folder.py::test_the_results_of_another_command_are_refused"],
    ),
    3: Row(
        what="scans without ranges",
        calls=scans("one_empty", "all_empty"),
        tests=["workflows/test_hostile_scans.py"],
    ),
    4: Row(
        what="beams and angles that no scanner has",
        calls=scans("increment_100", "beams_100000", "beams_1000000", commands=["fuse"]),
        tests=["workflows/test_hostile_scans.py", "model/test_sweep.py"],
    ),
    5: Row(
        what="stamps that jump",
        calls=times,
        tests=["model/test_stamps.py", "workflows/test_stamp_filter.py"],
    ),
    6: Row(
        what="settings that make the work endless, and jobs of nobody",
        calls=wide_settings,
        tests=[
            "test_settings.py",
            "app/test_server.py::test_an_alignment_that_a_link_asked_for_ends_with_its_browser",
        ],
    ),
    7: Row(
        what="two runs into one new folder",
        calls=two_at_once,
        tests=[
            "files/test_work_folder.py",
            "exporting/test_output_folder.py::test_a_second_run_into_the_folder_is_refused",
        ],
    ),
    8: Row(what="a user without a home", calls=nobodys_home, tests=["test_compiled.py"]),
    9: Row(what="a bag with roslib/Header", calls=old_bag, tests=["recordings/test_old_bags.py"]),
    10: Row(what="silent sockets", calls=silent_sockets, tests=["app/test_connections.py"]),
    11: Row(
        what="kills: of the manifest (11), while publishing (12), of convert (13)",
        calls=killed,
        tests=[
            "exporting/test_output_folder.py::test_a_run_killed_while_it_publishes_is_simply_repeated",
            "exporting/test_output_folder.py::test_a_mix_of_two_runs_is_not_a_result",
            "files/test_atomic.py::test_a_killed_process_leaves_no_lock",
        ],
    ),
    14: Row(
        what="names that are not UTF-8",
        calls=names,
        tests=[
            "workflows/test_names.py",
            "app/test_server.py::test_names_that_are_no_utf8_reach_the_browser",
        ],
    ),
    15: Row(
        what="a mount that explains nothing",
        calls=mounts,
        tests=["workflows/test_recorded_mount.py"],
    ),
    16: Row(
        what="ranges and poses far beyond", calls=outliers, tests=["workflows/test_outliers.py"]
    ),
    17: Row(what="ports that are none", calls=ports, tests=["app/test_listening.py"]),
    18: Row(
        what="a flipped byte in an MCAP file", calls=flipped, tests=["recordings/test_check.py"]
    ),
    19: Row(what="numbers too large", calls=numbers, tests=["exporting/test_settings_file.py"]),
    20: Row(
        what="options out of range",
        calls=options,
        tests=[
            "app/test_cli.py::test_a_number_out_of_range_is_wrong_usage",
            "recordings/test_formats.py::test_the_root_of_a_disk_is_a_folder_without_a_name",
        ],
    ),
    21: Row(
        what="devices and pipes",
        calls=devices,
        tests=["app/test_cli.py::test_nothing_waits_for_a_pipe", "files/test_regular_file.py"],
    ),
    22: Row(
        what="SIGTERM",
        calls=terminated,
        tests=[
            "app/test_interruption.py::test_a_build_that_is_ended_with_its_server_leaves_nothing"
        ],
        codes=[143],
    ),
    23: Row(
        what="links with numbers beyond 64 bits",
        calls=odd_links,
        tests=["app/test_server.py::test_whatever_number_a_link_holds_its_page_is_served"],
    ),
    24: Row(
        what="flipped bytes near a bag's end",
        calls=renamed,
        tests=["recordings/test_rosbag1_connections.py"],
    ),
    25: Row(
        what="wrong advice, cells too fine, numbers too far, malformed messages",
        calls=advice,
        tests=[
            "app/test_cli.py::test_advice_names_options_that_exist",
            "recordings/test_topics.py::test_a_depth_topic_is_named_once",
            "model/test_sensors.py",
            "app/test_complaints.py",
        ],
    ),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", type=int, nargs="*", default=sorted(ROWS))
    wrong = 0
    for number in parser.parse_args().only:
        row = ROWS[number]
        print(f"\n{number}. {row.what}")
        with tempfile.TemporaryDirectory(prefix="scanloom-hostile-") as folder:
            for call, ended in row.calls(Path(folder)):
                is_wrong = ended.code not in row.codes or "Traceback" in ended.output
                wrong += is_wrong
                print(f"  {call}{'   WRONG' if is_wrong else ''}")
                seconds, mib = ended.seconds, ended.peak_mib
                print(f"    exit {ended.code}, {seconds:.1f} s, {mib:.0f} MiB")
                for line in ended.said:
                    print(f"    {line.replace(folder, '...')[:_SHOWN]}")
        print(f"  tests: {', '.join(row.tests)}")
    print(f"\n{wrong} wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
