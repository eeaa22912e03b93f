"""Forty recordings through ``scanloom batch`` on a scheduler with two workers, one of which is
killed: what becomes of each, and which are flagged.

    python -m tests.benchmarks.fleet [--data FOLDER]

24 simulated recordings of one robot, of which one has its camera turned by 1 deg, one its clock off
by 60 ms and one a dusty lens; the rooms and the real bags of FOLDER (SCANLOOM_TEST_DATA by
default); three broken files, and one that claims to hold exabytes.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import pyarrow.parquet as pq

from fusion_core.simulation.faults import FaultSettings
from fusion_core.simulation.recorder import record_run
from fusion_core.simulation.scenes import SceneSettings, plan_run
from tests.app.test_fleet_batch import DUSTY, LATE, TURNED, scene_of
from tests.workflows.batch.cluster_processes import Cluster
from tests.workflows.batch.unreadable_files import unreadable_files

SIMULATED = 24
BAGS = ("guardian_3.bag", "jarvis_circular_path_fast.bag", "nav2_turtlebot.mcap")
KILLED_AFTER = 10


def write_all(folder: Path, data: Path) -> None:
    """The forty recordings, those of ``data`` as links."""
    for name in ("robot", "rooms", "bags", "broken"):
        (folder / name).mkdir(parents=True)
    for number in range(SIMULATED):
        settings = SceneSettings(
            seed=300 + number, duration_s=6.0, image_scale=0.5, camera_rate_hz=10.0
        )
        run = plan_run(scene_of(number), settings, FaultSettings())
        record_run(run, folder / "robot" / f"run_{number:02}.mcap")
    for room in sorted((data / "rooms").glob("room_*")):
        if not room.name.endswith(".npz"):
            (folder / "rooms" / room.name).symlink_to(room)
    for name in BAGS:
        (folder / "bags" / name).symlink_to(data / "real" / "bags" / name)
    for name, content in unreadable_files(folder / "robot" / "run_00.mcap").items():
        (folder / "broken" / name).write_bytes(content)


def batch(folder: Path, output: Path, scheduler: str) -> None:
    """Run the batch and print what it says."""
    begin = time.perf_counter()
    command = ["batch", str(folder), "-o", str(output), "--run", "fuse", "--scheduler", scheduler]
    done = subprocess.run(
        [sys.executable, "-m", "scanloom", *command, "--", "--no-maps", "--no-figures"],
        stdout=subprocess.PIPE,
        text=True,
    )
    print(done.stdout.replace(str(output), "OUT"), end="")
    print(f"exit code {done.returncode}, {time.perf_counter() - begin:.1f} s\n", flush=True)


def changed_at(output: Path) -> dict[str, int]:
    """When each file of a result was changed."""
    return {str(file): file.stat().st_mtime_ns for file in (output / "runs").rglob("*")}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--data", type=Path, default=os.environ.get("SCANLOOM_TEST_DATA"))
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, output = Path(name) / "data", Path(name) / "out"
        write_all(folder, Path(given.data))
        cluster = Cluster(Path(name))
        try:
            cluster.start_scheduler()
            for _ in range(2):
                cluster.start_worker()
            cluster.wait_for_workers(2)

            def kill() -> None:
                while len(list(output.glob("outcomes/*.json"))) < KILLED_AFTER:
                    time.sleep(0.05)
                os.killpg(cluster.processes[1].pid, signal.SIGKILL)
                print(f"a worker was killed after {KILLED_AFTER} recordings", flush=True)

            killer = threading.Thread(target=kill)
            killer.start()
            batch(folder, output, cluster.address)
            killer.join()
            before = changed_at(output)
            batch(folder, output, cluster.address)
            print(f"results redone: {sum(changed_at(output)[f] != t for f, t in before.items())}")
        finally:
            cluster.stop()
        rows = pq.read_table(output / "batch.parquet").to_pylist()
        print(f"rows {len(rows)}")
        for row in rows:
            if row["flags"]:
                print(f"flagged  {row['name']}: {', '.join(row['flags'])}")
                for reason in row["reasons"]:
                    print(f"         {reason}")
        wrong = {TURNED: "turned by 1 deg", LATE: "late by 60 ms", DUSTY: "dusty"}
        for number, what in wrong.items():
            row = next(row for row in rows if row["name"].endswith(f"run_{number:02}.mcap"))
            print(f"run_{number:02} {what}: {', '.join(row['flags']) or 'NOT FLAGGED'}")
        kept = Path("out") / "fleet_report.html"
        kept.parent.mkdir(exist_ok=True)
        shutil.copy(output / "report.html", kept)
        print(f"its report: {kept}")


if __name__ == "__main__":
    main()
