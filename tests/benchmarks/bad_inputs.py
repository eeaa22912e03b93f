"""What broken, cut, odd and mutated recordings do: a table, and how often something is wrong.

    python -m tests.benchmarks.bad_inputs [--mutations 1000]

Each input is read whole in a process of its own: as `scanloom info --json` reads it, then every
message. Wrong is a traceback, a line that names nothing, an exit code other than 0 or 1, 10 s more
or 256 MiB more than the intact file, and a changed input. The files below SCANLOOM_TEST_DATA are
tried where that is set.
"""

import argparse
import contextlib
import hashlib
import io
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.model.errors import ScanLoomError
from fusion_core.recordings.formats import open_recording
from scanloom.cli import main as scanloom
from tests.benchmarks.odd_recordings import ODD
from tests.recordings.samples.formats import SAMPLE_BUILDERS

FRACTIONS = (0.01, 0.5, 0.99)
MOST_SECONDS = 10.0
MOST_BYTES = 256 << 20
MIB = 1 << 20


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What one process made of an input. ``error`` is one line where it was refused."""

    exit_code: int
    error: str
    advice: str
    warnings: list[str]
    counted: int
    read: int
    traceback: str
    seconds: float
    peak_bytes: int

    @property
    def says(self) -> str:
        """The line that tells a person what happened."""
        if self.traceback:
            return f"TRACEBACK {self.traceback}"
        if self.exit_code:
            return self.error
        said = f"{self.read} of {self.counted} messages"
        return "; ".join([said, *self.warnings])


def read_whole(path: Path) -> dict[str, Any]:
    """In the child: `scanloom info --json`, then every message of every readable topic."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()):
            exit_code = scanloom(["info", "--json", str(path)])
        result = json.loads(said.getvalue())
        if exit_code:
            return {"exit_code": exit_code, "error": result["error"], "advice": result["advice"]}
        with open_recording(path) as recording:
            read = sum(1 for _ in recording.messages())
            counted = sum(topic.count for topic in recording.topics)
            return {
                "exit_code": 0,
                "warnings": list(recording.warnings),
                "counted": counted,
                "read": read,
            }
    except ScanLoomError as error:
        return {"exit_code": 1, "error": error.problem, "advice": error.advice}
    except BaseException as error:  # noqa: BLE001  # whatever it is, it is a finding
        return {"exit_code": 70, "traceback": f"{type(error).__name__}: {error}"[:200]}


def peak_bytes() -> int:
    """Of this process's own memory; what wait4 reports begins with the parent's."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) * 1024


def run(path: Path, timeout_s: float = 120.0) -> Outcome:
    """Read ``path`` in a process of its own, and measure it."""
    begin = time.perf_counter()
    with tempfile.TemporaryFile() as out:
        child = subprocess.Popen(
            [sys.executable, "-m", "tests.benchmarks.bad_inputs", "--child", str(path)],
            stdout=out,
            stderr=subprocess.DEVNULL,
        )
        try:
            child.wait(timeout_s)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
            return _outcome({"exit_code": 70, "traceback": "hangs"}, timeout_s)
        seconds = time.perf_counter() - begin
        out.seek(0)
        text = out.read().decode()
    said = json.loads(text) if text else {"exit_code": child.returncode, "traceback": "it died"}
    return _outcome(said, seconds)


def _outcome(said: dict[str, Any], seconds: float) -> Outcome:
    return Outcome(
        exit_code=said["exit_code"],
        error=said.get("error", ""),
        advice=said.get("advice", ""),
        warnings=said.get("warnings", []),
        counted=said.get("counted", 0),
        read=said.get("read", 0),
        traceback=said.get("traceback", ""),
        seconds=seconds,
        peak_bytes=said.get("peak_bytes", 0),
    )


def digest(path: Path) -> str:
    """Of a file, or of all files of a folder with their names; empty for what is neither."""
    found = hashlib.sha256()
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    for file in files:
        if file.is_file():
            found.update(str(file.relative_to(path)).encode())
            with contextlib.suppress(PermissionError):
                found.update(file.read_bytes())
    return found.hexdigest()


class Table:
    """Prints a row for each input and counts what is wrong."""

    def __init__(self) -> None:
        self.rows = 0
        self.wrong: list[str] = []
        print(f"{'input':<44} {'exit':>4} {'MiB':>5} {'s':>5}  printed")

    def add(self, name: str, path: Path, intact: Outcome | None = None) -> Outcome:
        """Run one input and print its row."""
        before = digest(path)
        outcome = run(path)
        self.rows += 1
        self._judge(name, outcome, intact, changed=digest(path) != before)
        says = outcome.says.replace(str(path), path.name)
        print(
            f"{name:<44} {outcome.exit_code:>4} {outcome.peak_bytes / MIB:>5.0f} "
            f"{outcome.seconds:>5.1f}  {says[:300]}",
            flush=True,
        )
        return outcome

    def _judge(self, name: str, outcome: Outcome, intact: Outcome | None, changed: bool) -> None:
        reasons = []
        if outcome.traceback or outcome.exit_code not in (0, 1):
            reasons.append(outcome.traceback or f"exit code {outcome.exit_code}")
        if outcome.exit_code == 1 and (not outcome.advice or "\n" in outcome.error):
            reasons.append("no clear line")
        if intact is not None and outcome.seconds > intact.seconds + MOST_SECONDS:
            reasons.append(f"{outcome.seconds:.1f} s")
        if intact is not None and outcome.peak_bytes > intact.peak_bytes + MOST_BYTES:
            reasons.append(f"{outcome.peak_bytes / MIB:.0f} MiB")
        if changed:
            reasons.append("input changed")
        if reasons:
            self.wrong.append(f"{name}: {', '.join(reasons)}")


def copy_of(source: Path, folder: Path) -> Path:
    """A writable copy of a file or folder in ``folder``."""
    folder.mkdir(parents=True)
    target = folder / source.name
    if source.is_dir():
        shutil.copytree(source, target)
    else:
        shutil.copy(source, target)
    for path in [target, *target.rglob("*")]:
        path.chmod(0o755 if path.is_dir() else 0o644)
    return target


def largest_file(path: Path) -> Path:
    """The file itself, or the largest of a folder."""
    if path.is_file():
        return path
    return max((file for file in path.rglob("*") if file.is_file()), key=lambda f: f.stat().st_size)


def cuts(table: Table, name: str, source: Path, work: Path) -> None:
    """The intact input, and it cut at 1, 50 and 99 % of the bytes of its largest file."""
    intact = table.add(f"{name}, intact", source)
    for fraction in FRACTIONS:
        copied = copy_of(source, work / f"{name}-{fraction}".replace("/", "_"))
        file = largest_file(copied)
        size = file.stat().st_size
        with file.open("r+b") as opened:
            opened.truncate(int(fraction * size))
        outcome = table.add(f"{name}, cut at {fraction:.0%}", copied, intact)
        recovered = outcome.read / intact.read if intact.read else 0.0
        print(f"{'':<44}                   {recovered:.1%} of the messages")


def mutated(content: bytes, rng: random.Random) -> bytes:
    """One of: flipped bits, swapped lengths, huge and zero counts, repeated and lost pieces."""
    data = bytearray(content)
    at = rng.randrange(max(1, len(data) - 8))
    kind = rng.randrange(6)
    if kind == 0:
        for _ in range(rng.randrange(1, 9)):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    elif kind == 1:
        other = rng.randrange(max(1, len(data) - 8))
        data[at : at + 4], data[other : other + 4] = data[other : other + 4], data[at : at + 4]
    elif kind == 2:
        data[at : at + 4] = rng.choice([b"\xff\xff\xff\xff", bytes(4), b"\xff\xff\xff\x7f"])
    elif kind == 3:
        data[at : at + 8] = rng.choice([b"\xff" * 8, b"\0\0\0\0\1\0\0\0", b"\0" * 7 + b"\x7f"])
    elif kind == 4:
        data[at:at] = data[at : at + rng.randrange(1, 4000)]
    else:
        del data[at : at + rng.randrange(1, 4000)]
    return bytes(data)


def mutate(name: str, count: int) -> dict[str, Any]:
    """In the child: ``count`` seeded mutations of a small file of one format, each read whole."""
    refused = damaged = 0
    slowest_s = 0.0
    failures: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        sample = SAMPLE_BUILDERS[name](Path(folder))
        baseline = peak_bytes()
        files = [sample.path] if sample.path.is_file() else sorted(sample.path.rglob("*"))
        files = [file for file in files if file.is_file()]
        contents = {file: file.read_bytes() for file in files}
        for seed in range(count):
            rng = random.Random(seed)
            file = rng.choice(files)
            data = mutated(contents[file], rng)
            file.write_bytes(data)
            begin = time.perf_counter()
            said = read_whole(sample.path)
            slowest_s = max(slowest_s, time.perf_counter() - begin)
            if said.get("traceback") or said["exit_code"] not in (0, 1):
                failures.append(f"seed {seed}: {said.get('traceback')}")
            elif said["exit_code"] == 1 and (not said["advice"] or "\n" in said["error"]):
                failures.append(f"seed {seed}: no clear line: {said['error']!r}")
            refused += said["exit_code"] == 1
            damaged += bool(said.get("warnings"))
            if file.read_bytes() != data:
                failures.append(f"seed {seed}: input changed")
            file.write_bytes(contents[file])
        growth = peak_bytes() - baseline
    return {
        "refused": refused,
        "warned": damaged,
        "failures": failures,
        "slowest_s": slowest_s,
        "growth_bytes": growth,
    }


def mutation_rows(table: Table, count: int) -> None:
    """A row for each format: what became of its mutations."""
    print(f"\n{count} mutations of each format: refused, read with a warning, growth, slowest")
    for name in SAMPLE_BUILDERS:
        argument = f"{name}\n{count}"
        done = subprocess.run(
            [sys.executable, "-m", "tests.benchmarks.bad_inputs", "--mutate", argument],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            table.wrong.append(f"mutations of {name}: exit code {done.returncode}")
            print(f"{name:<44} exit code {done.returncode}: {done.stderr.strip()[-200:]}")
            continue
        said = json.loads(done.stdout)
        print(
            f"{name:<44} {said['refused']:>4} {said['warned']:>4} "
            f"{said['growth_bytes'] / MIB:>5.0f} MiB {said['slowest_s']:>5.1f} s",
            flush=True,
        )
        table.rows += count
        table.wrong.extend(f"{name}, {failure}" for failure in said["failures"])
        if said["growth_bytes"] > MOST_BYTES or said["slowest_s"] > MOST_SECONDS:
            table.wrong.append(f"{name}: {said['growth_bytes']} bytes, {said['slowest_s']:.1f} s")


def shared_inputs(data: Path) -> Iterator[tuple[str, Path]]:
    """Everything odd, and everything that is no recording, below the shared folder."""
    real = data / "real"
    odd = real / "odd"
    for path in sorted(odd.rglob("*")):
        if path.is_file() or any(child.is_file() for child in path.iterdir()):
            yield f"odd/{path.relative_to(odd)}"[-44:], path
    for folder in ("trajectories", "calibration"):
        for path in sorted((real / folder).rglob("*")):
            if path.is_file():
                yield str(path.relative_to(real))[-44:], path
    yield from (("carmen/" + path.name, path) for path in sorted(real.rglob("*.relations")))


def places(work: Path) -> Iterator[tuple[str, Path]]:
    """Paths that are no files to read."""
    folder = work / "places"
    (folder / "empty").mkdir(parents=True)
    yield "an empty folder", folder / "empty"
    (folder / "stuff").mkdir()
    (folder / "stuff" / "notes.txt").write_text("nothing here\n")
    yield "a folder without a recording", folder / "stuff"
    yield "a missing file", folder / "missing.bag"
    (folder / "empty.mcap").touch()
    yield "an empty file", folder / "empty.mcap"
    os.mkfifo(folder / "pipe.bag")
    yield "a pipe", folder / "pipe.bag"
    (folder / "loop.mcap").symlink_to("loop.mcap")
    yield "a link to itself", folder / "loop.mcap"
    yield "a device", Path("/dev/null")
    (folder / "noise.bag").write_bytes(np.random.default_rng(0).bytes(100_000))
    yield "random bytes", folder / "noise.bag"
    locked = folder / "locked.mcap"
    locked.write_bytes(b"\x89MCAP0\r\n")
    locked.chmod(0)
    yield "a file without permission (root may read it)", locked


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mutations", type=int, default=1000)
    parser.add_argument("--child", type=Path)
    parser.add_argument("--mutate")
    asked = parser.parse_args()
    if asked.child is not None:
        json.dump({**read_whole(asked.child), "peak_bytes": peak_bytes()}, sys.stdout)
        return
    if asked.mutate is not None:
        name, count = asked.mutate.split("\n")
        json.dump(mutate(name, int(count)), sys.stdout)
        return
    table = Table()
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        for name, path in places(work):
            table.add(name, path)
        _odd_rows(table, work, ODD)
        for name, builder in SAMPLE_BUILDERS.items():
            place = work / "built" / name.replace(" ", "_")
            place.mkdir(parents=True)
            cuts(table, name, builder(place).path, work)
        data = os.environ.get("SCANLOOM_TEST_DATA")
        if data is None:
            print("SCANLOOM_TEST_DATA is not set: no shared recordings.")
        else:
            for name, path in shared_inputs(Path(data)):
                table.add(name, path)
            for path in sorted((Path(data) / "rooms").iterdir()):
                if path.suffix not in (".npz", ".md"):
                    cuts(table, path.name, path, work)
            for kind in ("bags", "carmen"):
                for path in sorted((Path(data) / "real" / kind).iterdir()):
                    if path.suffix != ".relations":
                        cuts(table, path.name, path, work)
    mutation_rows(table, asked.mutations)
    print(f"\n{table.rows} inputs, {len(table.wrong)} wrong")
    print("\n".join(table.wrong))
    sys.exit(bool(table.wrong))


def _odd_rows(table: Table, work: Path, odd: dict[str, Callable[[Path], Path]]) -> None:
    for name, write in odd.items():
        folder = work / "written" / name.replace(" ", "_")
        folder.mkdir(parents=True)
        table.add(name, write(folder))


if __name__ == "__main__":
    main()
