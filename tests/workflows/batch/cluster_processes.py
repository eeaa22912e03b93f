"""A Dask scheduler and its workers, as somebody else would run them."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from distributed import Client


@dataclass
class Cluster:
    """A scheduler and its workers, all processes of their own, on the loopback address."""

    folder: Path
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)
    address: str = ""

    def start(self, *command: str, **env: str) -> subprocess.Popen[bytes]:
        number = len(self.processes)
        with (self.folder / f"{number}.log").open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", *command],
                stdout=log,
                stderr=log,
                env=os.environ | env,
                cwd=self.folder,
                start_new_session=True,
            )
        self.processes.append(process)
        return process

    def start_scheduler(self) -> subprocess.Popen[bytes]:
        told = self.folder / "scheduler.json"
        options = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        scheduler = self.start("scheduler", *options, "--scheduler-file", str(told))
        while True:
            try:
                self.address = json.loads(told.read_text())["address"]
                return scheduler
            except (OSError, ValueError):
                assert scheduler.poll() is None, "the scheduler has ended"
                time.sleep(0.02)

    def start_worker(self, **env: str) -> subprocess.Popen[bytes]:
        options = ("--host", "127.0.0.1", "--nthreads", "1", "--no-dashboard")
        return self.start("worker", self.address, *options, **env)

    def wait_for_workers(self, count: int) -> None:
        with Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=120)

    def stop(self) -> None:
        for process in self.processes:
            # With what it has started itself.
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
