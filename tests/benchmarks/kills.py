"""``kill -9`` of fuse, map and convert, at any moment and while results are put in place.

    python -m tests.benchmarks.kills [--kills 200] [--seed 0]

Each killed run writes into a place that holds the results of an earlier run on other input.
After it, what ``evaluate`` takes must be all of one run, and the next run must end well and leave
just its own files. Prints a table, and exits with 1 where anything did not hold.
"""

import argparse
import hashlib
import itertools
import multiprocessing
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from multiprocessing.context import ForkProcess
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path

from fusion_core.exporting.manifest import require_intact
from fusion_core.model.errors import ScanLoomError
from fusion_core.workflows import (
    fuse,  # noqa: F401
)

# The commands import their work when they are called; here once, before the processes part.
from scanloom import cli
from tests.workflows.box_recording import standing, turning, write_boxes

# What each command gives for evaluate to read.
READ = {
    "fuse": ("alignment.json", "frames.csv", "samples.parquet"),
    "map": ("report.json", "trajectory.tum", "map_lidar.pgm", "map_lidar.yaml"),
}
COMMANDS = ("fuse", "map", "convert")
ANY_MOMENT, PUBLISHING = "any moment", "a change of names"
# How often there are results of an earlier run.
EARLIER_SHARE = 0.8
# Calls that change what has a name, as publishing does.
CHANGING = ("replace", "unlink", "mkdir", "rmdir")


@dataclass
class Row:
    """What became of the kills of one kind."""

    kills: int = 0
    ended_before: int = 0
    mixes_taken: int = 0
    refused: int = 0
    left_behind: int = 0
    problems: list[str] = field(default_factory=list)


def words(command: str, recording: Path, output: Path) -> list[str]:
    """The command line of a run."""
    options = {"fuse": "--no-figures", "map": "--motion=none", "convert": "--overwrite"}
    return [command, str(recording), "-o", str(output), options[command]]


def quietly(line: list[str]) -> int:
    with Path(os.devnull).open("w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        return cli.main(line)


def run_whole(line: list[str]) -> None:
    sys.exit(quietly(line))


def run_counting(line: list[str], calls: "Synchronized[int]", kill_at: int) -> None:
    """Run a command that counts its changes of names, and kills itself before one of them."""

    def counted(change: Callable[..., object]) -> Callable[..., object]:
        def wrapped(*args: object, **kwargs: object) -> object:
            calls.value += 1
            if calls.value == kill_at:
                os.kill(os.getpid(), signal.SIGKILL)
            return change(*args, **kwargs)

        return wrapped

    for name in CHANGING:
        setattr(Path, name, counted(getattr(Path, name)))
    sys.exit(quietly(line))


def contents(place: Path) -> dict[str, str]:
    """Every file at an output, hidden ones too, by its digest; hidden folders by their name."""
    folder = place if place.suffix != ".mcap" else place.parent
    found = {}
    for path in folder.rglob("*"):
        name = path.relative_to(folder).as_posix()
        if path.is_file():
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
        elif path.name.startswith("."):
            found[name] = "folder"
    return found


def taken(command: str, output: Path) -> dict[str, str] | None:
    """What a reader of results takes, by its digests; None where it refuses."""
    if command == "convert":
        return {output.name: contents(output)[output.name]} if output.exists() else None
    names = READ[command]
    try:
        require_intact(output, names, command)
    except ScanLoomError:
        return None
    if not all((output / name).exists() for name in names):
        return None
    return {name: hashlib.sha256((output / name).read_bytes()).hexdigest() for name in names}


class Kills:
    """Kills runs below a folder, and looks at what is left."""

    def __init__(self, root: Path, seed: int) -> None:
        self._draws = random.Random(seed)
        self._context = multiprocessing.get_context("fork")
        self._root = root
        self._recordings = [root / "standing.mcap", root / "turning.mcap"]
        for recording, drive in zip(self._recordings, (standing, turning), strict=True):
            write_boxes(recording, drive=drive, duration_s=0.4)
        self._whole: dict[str, list[dict[str, str]]] = {}
        self._seconds: dict[str, float] = {}
        self._calls: dict[str, int] = {}
        for command in COMMANDS:
            self._measure(command)

    def _measure(self, command: str) -> None:
        """What whole runs leave, how long one takes, and how many names it changes."""
        self._whole[command] = []
        for recording in self._recordings:
            output = place(self._root / f"whole-{recording.stem}", command)
            line = words(command, recording, output)
            calls = self._context.Value("i", 0)
            start_s = time.perf_counter()
            assert self._ends(run_counting, line, calls, 0) == 0
            self._seconds[command] = time.perf_counter() - start_s
            self._calls[command] = calls.value
            self._whole[command].append(contents(output))
        first, second = self._whole[command]
        assert first != second, f"{command}: both runs give the same"

    def kill(self, command: str, aim: str, row: Row) -> None:
        """One kill, what a reader takes after it, and the run after that."""
        output = place(self._root / "out", command)
        before, after = self._draws.sample((0, 1), 2)
        if self._draws.random() < EARLIER_SHARE:
            self._ends(run_whole, words(command, self._recordings[before], output))
        line = words(command, self._recordings[after], output)
        if aim == ANY_MOMENT:
            killed = self._begin(run_whole, line)
            time.sleep(self._draws.uniform(0.0, self._seconds[command]))
            killed.kill()
        else:
            at = self._draws.randint(1, self._calls[command])
            killed = self._begin(run_counting, line, self._context.Value("i", 0), at)
        killed.join()
        row.kills += 1
        row.ended_before += killed.exitcode == 0
        read = taken(command, output)
        whole = self._whole[command]
        if read is not None and not any(read.items() <= run.items() for run in whole):
            row.mixes_taken += 1
            row.problems.append(f"{command}: a mix was taken: {sorted(read)}")
        code = self._ends(run_whole, line)
        if code != 0:
            row.refused += 1
            row.problems.append(f"{command}: the next run ended with {code}")
        elif (left := contents(output)) != whole[after]:
            row.left_behind += 1
            odd = sorted(dict(left.items() ^ whole[after].items()))
            row.problems.append(f"{command}: not as a whole run leaves it: {odd[:4]}")
        shutil.rmtree(self._root / "out", ignore_errors=True)

    def _begin(self, work: Callable[..., None], *args: object) -> ForkProcess:
        process = self._context.Process(target=work, args=args)
        process.start()
        return process

    def _ends(self, work: Callable[..., None], *args: object) -> int | None:
        process = self._begin(work, *args)
        process.join()
        return process.exitcode


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rows: dict[tuple[str, str], Row] = {}
    with tempfile.TemporaryDirectory(prefix="scanloom-kills-") as name:
        kills = Kills(Path(name), options.seed)
        kinds = itertools.cycle(itertools.product(COMMANDS, (ANY_MOMENT, PUBLISHING)))
        for command, aim in itertools.islice(kinds, options.kills):
            kills.kill(command, aim, rows.setdefault((command, aim), Row()))
    return report(rows)


def place(folder: Path, command: str) -> Path:
    """Where a command writes below ``folder``."""
    target = folder / command
    if command != "convert":
        return target
    target.mkdir(parents=True, exist_ok=True)
    return target / "out.mcap"


def report(rows: dict[tuple[str, str], Row]) -> int:
    print("command  killed at         kills  ended before  mixes taken  refused  left behind")
    for (command, aim), row in sorted(rows.items()):
        print(
            f"{command:<8} {aim:<17} {row.kills:>5}  {row.ended_before:>12}  {row.mixes_taken:>11}"
            f"  {row.refused:>7}  {row.left_behind:>11}"
        )
    problems = [problem for row in rows.values() for problem in row.problems]
    for problem in problems:
        print(problem)
    print(f"{sum(row.kills for row in rows.values())} kills, {len(problems)} problems")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
