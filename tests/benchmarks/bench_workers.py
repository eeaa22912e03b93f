"""``fuse`` with one worker and with several: time, memory, and whether the bytes are the same.

    python -m tests.benchmarks.bench_workers [RECORDING ...] [--minutes N ...] [--workers N]

By default the built-in sample; ``--minutes`` generates recordings of that length. Each run is a
process of its own, after one that is not counted. "rest" is all but the alignment, which one
process does. Memory is the most that all processes held together, with the pages that they share
counted in each; "of its own" leaves out those of files, most of which are libraries and shared.
Single runs side by side share nothing: their throughput, as a multiple of one run's, is what the
machine gives at most.

A process that is spawned imports the main module of its parent: the library is imported where it is
used, so that a worker holds what one of ``scanloom fuse`` does.
"""

import argparse
import hashlib
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

SAMPLE = Path(__file__).parents[2] / "samples" / "furnished_room.mcap"
BAR_SPEED_UP, BAR_MIB_A_WORKER = 1.7, 250.0
ROUNDS = 3


def resident_mib(pid: int, kind: str) -> float:
    """What a process holds, 0 once it has ended. ``kind``: VmRSS all, RssAnon without files."""
    try:
        status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    except (FileNotFoundError, ProcessLookupError):
        return 0.0
    _, _, rest = status.partition(f"{kind}:")
    return int(rest.split()[0]) / 1024.0 if rest else 0.0


def run_once(recording: Path, workers: int, *, figures: bool) -> None:
    """Fuse, and print what it took as JSON."""
    from fusion_core.workflows.fuse import fuse as module
    from fusion_core.workflows.fuse.session import FuseOptions

    own_pid = os.getpid()
    most_mib = dict.fromkeys(("VmRSS", "RssAnon"), 0.0)
    aligned_s = 0.0
    is_over = threading.Event()

    def watch() -> None:
        while not is_over.wait(0.02):
            pids = [own_pid, *(child.pid or 0 for child in multiprocessing.active_children())]
            for kind, most in most_mib.items():
                most_mib[kind] = max(most, sum(resident_mib(pid, kind) for pid in pids))

    def timed(*args: Any, **named: Any) -> Any:
        nonlocal aligned_s
        begin = time.perf_counter()
        try:
            return align(*args, **named)
        finally:
            aligned_s = time.perf_counter() - begin

    align = module.align_recording
    threading.Thread(target=watch, daemon=True).start()
    with tempfile.TemporaryDirectory() as folder, patch.object(module, "align_recording", timed):
        output = Path(folder) / "fused"
        begin = time.perf_counter()
        summary = module.fuse(recording, output, FuseOptions(workers=workers, figures=figures))
        whole_s = time.perf_counter() - begin
        digest = hashlib.sha256()
        for file in sorted(output.rglob("*")):
            if file.is_file():
                digest.update(f"{file.relative_to(output)}\n".encode())
                digest.update(file.read_bytes())
    is_over.set()
    print(
        json.dumps(
            {
                "pairs": summary.paired,
                "align_s": aligned_s,
                "rest_s": whole_s - aligned_s,
                "mib": most_mib["VmRSS"],
                "own_mib": most_mib["RssAnon"],
                "digest": digest.hexdigest(),
            }
        )
    )


def measured(recording: Path, workers: int, rounds: int, *, figures: bool) -> dict[str, Any]:
    """The fastest of some runs."""
    command = [sys.executable, "-m", "tests.benchmarks.bench_workers", "--once", str(workers)]
    command += [str(recording)] + ([] if figures else ["--no-figures"])
    runs = []
    for _ in range(rounds):
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        runs.append(json.loads(done.stdout))
    assert len({run["digest"] for run in runs}) == 1, "two runs differ"
    best: dict[str, Any] = min(runs, key=lambda run: float(run["rest_s"]))
    return best


def side_by_side_s(recording: Path, count: int, *, figures: bool) -> float:
    """Seconds that single-worker runs at the same time take for the rest: what the machine's cores
    give when nothing has to be shared."""
    command = [sys.executable, "-m", "tests.benchmarks.bench_workers", "--once", "1"]
    command += [str(recording)] + ([] if figures else ["--no-figures"])
    runs = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(count)]
    return max(float(json.loads(run.communicate()[0])["rest_s"]) for run in runs)


def compare(recording: Path, workers: int, rounds: int, *, figures: bool) -> None:
    """Print a line for a recording."""
    one = measured(recording, 1, rounds, figures=figures)
    many = measured(recording, workers, rounds, figures=figures)
    together_s = side_by_side_s(recording, workers, figures=figures)
    more_mib, own_mib = ((many[key] - one[key]) / (workers - 1) for key in ("mib", "own_mib"))
    print(
        f"{recording.name:24}{'with' if figures else 'no':>5} figures {one['pairs']:6} pairs   "
        f"1 worker: align {one['align_s']:6.2f} s, rest {one['rest_s']:7.2f} s, "
        f"{one['mib']:4.0f} MiB   {workers} workers: align {many['align_s']:6.2f} s, rest "
        f"{many['rest_s']:7.2f} s, {more_mib:4.0f} MiB more for each "
        f"(at most {BAR_MIB_A_WORKER:.0f}; {own_mib:.0f} of its own)   "
        f"speed-up {one['rest_s'] / many['rest_s']:.2f} (bar {BAR_SPEED_UP}; "
        f"as many single runs side by side: {workers * one['rest_s'] / together_s:.2f})   "
        f"same bytes: {one['digest'] == many['digest']}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("recordings", nargs="*", type=Path)
    parser.add_argument("--minutes", nargs="*", type=float, default=[])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--no-figures", action="store_true")
    parser.add_argument("--once", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.once is not None:
        run_once(given.recordings[0], given.once, figures=not given.no_figures)
        return
    kinds = [False] if given.no_figures else [False, True]
    for recording in given.recordings or ([] if given.minutes else [SAMPLE]):
        for figures in kinds:
            compare(recording, given.workers, given.rounds, figures=figures)
    if not given.minutes:
        return
    from fusion_core.simulation.scenes import SceneSettings, write_scene

    with tempfile.TemporaryDirectory() as folder:
        for minutes in given.minutes:
            recording = Path(folder) / f"{minutes:g}_minutes.mcap"
            settings = SceneSettings(
                duration_s=60.0 * minutes, camera_rate_hz=10.0, image_scale=0.5
            )
            write_scene("furnished_room", recording, settings=settings)
            for figures in kinds:
                compare(recording, given.workers, 1, figures=figures)


if __name__ == "__main__":
    main()
