"""What a journal of a million actions costs: opening, acting, reading, counting, exporting.

    python -m tests.benchmarks.bench_labels [--actions 1000000] [--captures 2000]
        [--postgresql postgresql://USER@HOST/EMPTY_DATABASE]

Each prepared action changes one sample: a random beam of a random scan of 1,000, in one layer. They
are inserted in bulk; everything that is timed goes through LabelStore.
"""

import argparse
import hashlib
import multiprocessing
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import Connection, insert

from fusion_core.annotation import schema
from fusion_core.annotation.address import open_database
from fusion_core.annotation.identity import Author, RecordingIdentity
from fusion_core.annotation.store import LabelStore
from fusion_core.model.labels import NO_LABEL, Capture, CaptureLabels, Label
from fusion_core.model.progress import silent
from fusion_core.workflows.labels.export_labels import ExportOptions, export_labels

RECORDING = RecordingIdentity("benchmark.mcap", hashlib.sha256(b"").hexdigest())
ANNA = Author("anna")
BEAMS = 1000
AT_ONCE = 20_000
MIB = 1 << 20


def capture(number: int) -> Capture:
    """Scans of 10 Hz."""
    return Capture("lidar", "/scan", number * 100_000_000, 0, 1, BEAMS)


def prepare(address: str, actions: int, captures: int) -> dict[Label, int]:
    """Fill an empty store. Returns how many samples have each label."""
    random = np.random.default_rng(1)
    of_capture = random.integers(captures, size=actions).tolist()
    beams = random.integers(BEAMS, size=actions).tolist()
    steps = random.integers(1, len(Label) + 1, size=actions).tolist()
    state: dict[tuple[int, int], int] = {}

    def rows() -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
        for number, (owner, beam, step) in enumerate(zip(of_capture, beams, steps, strict=True)):
            before = state.get((owner, beam), NO_LABEL)
            # Another of the codes from NO_LABEL on.
            after = (before - NO_LABEL + step) % (len(Label) + 1) + NO_LABEL
            state[owner, beam] = after
            action = {
                "id": number + 1,
                "layer_id": 1,
                "kind": "do",
                "target_id": None,
                "below_id": number or None,
                "time_utc": "2025-01-01T00:00:00.000000+00:00",
                "annotator": ANNA.annotator,
                "source": ANNA.source,
                "settings_sha256": "",
                "version": "0.1.0",
                "comment": "",
            }
            change = (number + 1, 1, owner + 1, 0, beam, before, after)
            yield action, dict(zip(schema.change.c.keys(), change, strict=True))

    LabelStore.open(address, RECORDING, create=True).close()
    database = open_database(address, RECORDING, create=False)
    with database.writing() as connection:
        connection.execute(insert(schema.layer).values(id=1, name="anna"))
        places = [capture(number) for number in range(captures)]
        connection.execute(
            insert(schema.capture),
            [
                {"id": number, **{name: getattr(place, name) for name in place.__slots__}}
                for number, place in enumerate(places, start=1)
            ],
        )
        stream = rows()
        while batch := list(islice(stream, AT_ONCE)):
            _insert(connection, batch)
    database.close()
    counts = Counter(state.values())
    return {label: counts[label] for label in Label}


def _insert(connection: Connection, batch: list[tuple[dict[str, Any], dict[str, Any]]]) -> None:
    if connection.dialect.name == "postgresql":
        cursor = connection.connection.cursor()
        for table, rows in ((schema.action, 0), (schema.change, 1)):
            names = ", ".join(f'"{column.name}"' for column in table.columns)
            with cursor.copy(f"COPY {table.name} ({names}) FROM STDIN") as copy:
                for row in batch:
                    copy.write_row(tuple(row[rows].values()))
        return
    # A change belongs to the newest action: they alternate.
    raw = connection.connection.cursor()
    for action, change in batch:
        for table, row in ((schema.action, action), (schema.change, change)):
            marks = ", ".join("?" * len(row))
            raw.execute(f"INSERT INTO {table.name} VALUES ({marks})", tuple(row.values()))


def resident_mib(key: str = "VmRSS") -> float:
    """Of this process; VmHWM is the highest since ``reset_highest``."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    return int(status.partition(f"{key}:")[2].split()[0]) * 1024 / MIB


def reset_highest() -> None:
    Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")


def once(what: str, work: Callable[[], object]) -> None:
    """Print how long one call takes, and how far memory rises."""
    reset_highest()
    before, begin = resident_mib(), time.perf_counter()
    result = work()
    seconds = time.perf_counter() - begin
    risen = resident_mib("VmHWM") - before
    print(f"{what:44} {seconds:8.3f} s   +{risen:6.1f} MiB   {result}", flush=True)


def repeated(what: str, work: Callable[[int], object], count: int) -> None:
    """Print the distribution of many calls."""
    seconds = []
    for number in range(count):
        begin = time.perf_counter()
        work(number)
        seconds.append(time.perf_counter() - begin)
    middle, high, highest = np.percentile(np.array(seconds) * 1e3, [50, 95, 100])
    print(
        f"{what:44} median {middle:6.2f} ms   95 % {high:6.2f} ms   highest {highest:6.2f} ms "
        f"  ({count} calls)",
        flush=True,
    )


def stream_all(store: LabelStore) -> str:
    """Read all labels as an export does."""
    captures = samples = 0
    for labels in store.labelled("anna"):
        captures += 1
        samples += len(labels.row)
    return f"{samples} labels of {captures} captures"


def export(address: str, folder: Path, format: str) -> str:
    """What ``scanloom labels export`` does, with an empty file as the recording."""
    recording = folder / RECORDING.name
    recording.touch()
    options = ExportOptions(address=address, format=format)
    exported = export_labels(recording, folder / f"exported_{format}", options, silent)
    return f"{exported['written']} labels"


def measure(address: str, folder: Path, expected: dict[Label, int], captures: int) -> None:
    """Print a line for each thing that is timed. In a process of its own: what the preparation has
    freed would hide what memory is taken."""
    print(f"resident at the start {resident_mib():.1f} MiB")
    opened: list[LabelStore] = []
    once("open", lambda: opened.append(LabelStore.open(address, RECORDING, create=False)))
    (store,) = opened
    random = np.random.default_rng(2)
    codes = [int(label) for label in Label]

    def label(number: int) -> None:
        row, beam = np.zeros(1, int), np.array([int(random.integers(BEAMS))])
        place = capture(int(random.integers(captures)))
        store.label("anna", [CaptureLabels.of_samples(place, row, beam, codes[number % 5])], ANNA)

    with store:
        once("counts, the first time", lambda: sum(store.counts("anna").values()))
        assert store.counts("anna") == expected
        repeated("an action of one sample", label, 1000)
        repeated("undo", lambda _: store.undo("anna", "anna"), 500)
        repeated("redo", lambda _: store.redo("anna", "anna"), 500)
        repeated("tops of the undo stacks", lambda _: store.tops("anna", "anna"), 500)
        repeated("head", lambda _: store.head(), 500)
        repeated(
            "labels of a capture",
            lambda _: store.labels_of("anna", capture(int(random.integers(captures)))),
            500,
        )
        repeated(
            "counts after an action", lambda number: (label(number), store.counts("anna")), 200
        )
        once("all labels, streamed", lambda: stream_all(store))
        once("digest of the layer", lambda: store.layer("anna").sha256[:12])
        once("all actions, streamed", lambda: sum(1 for _ in store.actions()))
    for format in ("csv", "jsonl", "parquet"):
        once(f"export as {format}", lambda format=format: export(address, folder, format))
    print(f"resident at the end {resident_mib():.1f} MiB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--actions", type=int, default=1_000_000)
    parser.add_argument("--captures", type=int, default=2000)
    parser.add_argument("--postgresql", metavar="ADDRESS")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "benchmark.labels.sqlite"
        address = options.postgresql or str(path)
        begin = time.perf_counter()
        expected = prepare(address, options.actions, options.captures)
        print(f"{options.actions} actions prepared in {time.perf_counter() - begin:.0f} s")
        if options.postgresql is None:
            print(f"the file has {path.stat().st_size / MIB:.0f} MiB")
        child = multiprocessing.get_context("spawn").Process(
            target=measure, args=(address, Path(folder), expected, options.captures)
        )
        child.start()
        child.join()
        sys.exit(child.exitcode)


if __name__ == "__main__":
    main()
