"""Seconds and memory that `scanloom info` and the first frames take of very large recordings.

    python -m tests.benchmarks.large [--gigabytes 20]

Each measurement is a process of its own, with the file out of the page cache where the system can
do that. `info` counts from the start of the process; the frames from the open index. Each
recording is measured whole, and without its last thousandth, as a killed recorder leaves it.
Databases have no holes: they are of --database-gigabytes.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.session import FuseOptions, open_session
from fusion_core.workflows.fuse.settings import PRESETS
from scanloom.cli import main as scanloom

INFO_SECONDS, FRAME_SECONDS, MEMORY_MIB = 20.0, 5.0, 1024
KEPT_SHARE = 0.999
GB = 10**9
# What the holes of a file do not save.
_REAL_BYTES = 2 * GB


@dataclass(frozen=True, slots=True)
class Measured:
    """``first_s`` and ``middle_s``: from the open index to a frame's depth and scan."""

    messages: int
    info_s: float
    info_cpu_s: float
    info_mib: float
    first_s: float
    middle_s: float
    frames_mib: float

    @property
    def misses(self) -> list[str]:
        """The bars that are missed."""
        bars = {
            "info": self.info_s >= INFO_SECONDS,
            "first frame": self.first_s >= FRAME_SECONDS,
            "middle frame": self.middle_s >= FRAME_SECONDS,
            "memory": max(self.info_mib, self.frames_mib) >= MEMORY_MIB,
        }
        return [name for name, is_missed in bars.items() if is_missed]


def frames(path: Path) -> dict[str, float]:
    """In the child: seconds from the open index to the first frame, and then to the middle one."""
    with open_recording(path) as recording:
        begin = time.perf_counter()
        reader = FrameReader(open_session(recording, FuseOptions(), PRESETS["default"]))
        reader.pair(0)
        first = time.perf_counter()
        reader.pair(len(reader) // 2)
        return {"first_s": first - begin, "middle_s": time.perf_counter() - first}


def peak_mib() -> float:
    """Of this process's own memory; what wait4 reports begins with the parent's."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024.0


@dataclass(frozen=True, slots=True)
class Child:
    """What a process printed, and what it took. ``cpu_s`` leaves out disk and other work."""

    said: Any
    seconds: float
    cpu_s: float
    mib: float


def child(what: str, path: Path) -> Child:
    """Run ``info`` or ``frames`` in a process of its own."""
    _drop_from_cache(path)
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "tests.benchmarks.large", "--child", what, str(path)],
        stdout=subprocess.PIPE,
        check=True,
        text=True,
    )
    seconds = time.perf_counter() - begin
    said, _, taken = done.stdout.rstrip().rpartition("\n")
    cpu_s, mib = map(float, taken.split())
    return Child(json.loads(said), seconds, cpu_s, mib)


def _drop_from_cache(path: Path) -> None:
    if hasattr(os, "posix_fadvise"):
        with path.open("rb") as file:
            os.fsync(file.fileno())
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def measure(path: Path) -> Measured:
    info, shown = child("info", path), child("frames", path)
    return Measured(
        messages=sum(topic["count"] for topic in info.said["topics"]),
        info_s=info.seconds,
        info_cpu_s=info.cpu_s,
        info_mib=info.mib,
        frames_mib=shown.mib,
        **shown.said,
    )


def print_row(name: str, path: Path, measured: Measured) -> None:
    status = path.stat()
    print(
        f"{name:<34}{status.st_size / GB:>7.2f}{status.st_blocks * 512 / GB:>7.2f}"
        f"{measured.messages:>9}{measured.info_s:>8.2f}{measured.info_cpu_s:>7.2f}"
        f"{measured.info_mib:>6.0f}"
        f"{measured.first_s:>8.2f}{measured.middle_s:>8.2f}{measured.frames_mib:>6.0f}"
        f"  {', '.join(measured.misses)}".rstrip(),
        flush=True,
    )


def recordings(asked: argparse.Namespace, work: Path) -> Iterator[tuple[str, Path, int]]:
    """Name, file and number of messages of each; a file is gone when the next one is written."""
    # Here, since it would count in the memory of every child.
    from tests.benchmarks import large_recordings as make

    camera, busy = make.camera_streams(), make.busy_streams()
    seconds = asked.gigabytes * GB / sum(stream.bytes_per_s for stream in camera)
    database_seconds = seconds * asked.database_gigabytes / asked.gigabytes
    busy_seconds = asked.messages / sum(stream.rate_hz for stream in busy)
    plans: list[tuple[str, make.Write, list[make.Stream], float]] = [
        ("MCAP", make.write_mcap, camera, seconds),
        ("MCAP without chunks", make.write_mcap_without_chunks, camera, seconds),
        ("ROS 1 bag", make.write_bag, camera, seconds),
        ("ROS 2 database", make.write_database, camera, database_seconds),
        ("MCAP, small messages", make.write_mcap, busy, busy_seconds),
        ("MCAP without chunks, small", make.write_mcap_without_chunks, busy, busy_seconds),
        ("ROS 1 bag, small messages", make.write_bag, busy, busy_seconds),
        ("ROS 2 database, small messages", make.write_database, busy, busy_seconds),
    ]
    for name, write, streams, length_s in plans:
        with tempfile.TemporaryDirectory(dir=work) as folder:
            count = sum(int(length_s * stream.rate_hz) for stream in streams)
            yield name, write(Path(folder), streams, length_s), count


def main() -> None:
    """Print the table; exit 1 where a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gigabytes", type=float, default=20.0)
    parser.add_argument("--database-gigabytes", type=float, default=4.0)
    parser.add_argument("--messages", type=int, default=2_000_000)
    parser.add_argument("--folder", type=Path, help="where files are written for a while")
    parser.add_argument("--child", nargs=2)
    asked = parser.parse_args()
    if asked.child is not None:
        what, path = asked.child
        if what == "info":
            exit_code = scanloom(["info", "--json", path])
        else:
            exit_code = 0
            print(json.dumps(frames(Path(path))))
        print(time.process_time(), peak_mib())
        sys.exit(exit_code)
    missed = []
    print(f"{'':<34}{'GB':>7}{'disk':>7}{'messages':>9}", end="")
    print(f"{'info s':>8}{'CPU s':>7}{'MiB':>6}{'first s':>8}{'mid s':>8}{'MiB':>6}")
    print(f"{'bar':<57}{f'{INFO_SECONDS:g}':>8}{MEMORY_MIB:>13}", end="")
    print(f"{f'{FRAME_SECONDS:g}':>8}{f'{FRAME_SECONDS:g}':>8}{MEMORY_MIB:>6}")
    with tempfile.TemporaryDirectory(dir=asked.folder) as name:
        work = Path(name)
        needed = asked.database_gigabytes * GB + _REAL_BYTES
        if shutil.disk_usage(work).free < needed:
            sys.exit(f"{work} has less than {needed / GB:g} GB left; name another with --folder.")
        for title, path, count in recordings(asked, work):
            whole = measure(path)
            print_row(title, path, whole)
            if whole.messages != count:
                missed.append(f"{title}: {whole.messages} of {count} messages")
            os.truncate(path, int(KEPT_SHARE * path.stat().st_size))
            cut = measure(path)
            print_row("  without its end", path, cut)
            missed += [f"{title}: {bar}" for bar in [*whole.misses, *cut.misses]]
    print("\n".join(["", f"{len(missed)} missed", *missed]))
    sys.exit(bool(missed))


if __name__ == "__main__":
    main()
