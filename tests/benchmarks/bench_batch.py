"""What a batch adds to the work itself: time a recording, and memory of its scheduler and client.

    python -m tests.benchmarks.bench_batch [RECORDINGS...]

Files of eight bytes go through a scheduler and two workers, each a process of its own, to a command
that returns their size; the outcome of each is a file, flushed to disk. Prints a row for each count
(1,000, 3,000 and 10,000 unless given), and the exponent of the time against the count. The second
time is that of the same batch called again, when all is done.
"""

import argparse
import math
import os
import tempfile
import time
from pathlib import Path

import psutil

from fusion_core.workflows.batch.batch import run_batch
from fusion_core.workflows.batch.items import find_items
from fusion_core.workflows.batch.settings import BatchSettings
from tests.workflows.batch.cluster_processes import Cluster
from tests.workflows.batch.stub_call import StubCall, write_recordings

COUNTS = (1_000, 3_000, 10_000)
WORKERS = 2
_MIB = 1 << 20
_LOOK_EVERY = 200


def rss_mib(pid: int) -> float:
    return float(psutil.Process(pid).memory_info().rss) / _MIB


def measure(count: int, folder: Path) -> float:
    """One row of the table; the seconds of the batch."""
    data = write_recordings(folder / "data", *(f"good_{number:06}" for number in range(count)))
    (folder / "counts").mkdir()
    (folder / "cluster").mkdir()
    call = StubCall(counts=folder / "counts")
    cluster = Cluster(folder / "cluster")
    try:
        scheduler = cluster.start_scheduler()
        for _ in range(WORKERS):
            cluster.start_worker()
        cluster.wait_for_workers(WORKERS)
        started_s = time.perf_counter()
        items = find_items([str(data)])
        found_s = time.perf_counter() - started_s
        first = {"scheduler": rss_mib(scheduler.pid), "client": rss_mib(os.getpid())}
        greatest = dict(first)

        def look(done: int, total: int | None, what: str) -> None:
            if done % _LOOK_EVERY == 0:
                greatest["scheduler"] = max(greatest["scheduler"], rss_mib(scheduler.pid))
                greatest["client"] = max(greatest["client"], rss_mib(os.getpid()))

        def batch() -> float:
            begun_s = time.perf_counter()
            summary = run_batch(
                items,
                call,
                folder / "out",
                BatchSettings(),
                scheduler=cluster.address,
                progress=look,
            )
            assert summary.done == count
            return time.perf_counter() - begun_s

        seconds, again_s = batch(), batch()
    finally:
        cluster.stop()
    print(
        f"{count:>10,} {found_s:>8.1f} {seconds:>8.1f} {1e3 * seconds / count:>8.2f} "
        f"{again_s:>8.1f} {first['scheduler']:>8.0f} -> {greatest['scheduler']:<4.0f}"
        f"{first['client']:>8.0f} -> {greatest['client']:<4.0f}",
        flush=True,
    )
    return seconds


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recordings", nargs="*", type=int, default=COUNTS)
    counts: list[int] = list(parser.parse_args().recordings)
    print("recordings  found s  batch s  ms each  again s  scheduler MiB    client MiB")
    times = []
    for count in counts:
        with tempfile.TemporaryDirectory() as folder:
            times.append(measure(count, Path(folder)))
    if len(counts) > 1:
        exponent = math.log(times[-1] / times[0]) / math.log(counts[-1] / counts[0])
        print(f"time grows with the recordings to the power of {exponent:.2f}")


if __name__ == "__main__":
    main()
