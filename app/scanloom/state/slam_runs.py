"""The last few SLAM runs of one browser."""

import threading

from scanloom.jobs.slam_run import SlamRun

# A run's folder takes some megabytes in the temporary folder.
MAX_RUNS = 8


class SlamRuns:
    """The runs of one browser, oldest first. Thread-safe.

    The caller deletes the folder of the run that ``add`` returns, the oldest beyond ``MAX_RUNS``.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._runs: list[SlamRun] = []
        self._count = 0

    def next_number(self) -> int:
        """A number that no earlier run of this browser had."""
        with self._lock:
            self._count += 1
            return self._count

    def add(self, run: SlamRun) -> SlamRun | None:
        """Add a run; returns the one that was dropped for it."""
        with self._lock:
            self._runs.append(run)
            return self._runs.pop(0) if len(self._runs) > MAX_RUNS else None

    def of(self, recording: str) -> list[SlamRun]:
        """The runs of one recording."""
        with self._lock:
            return [run for run in self._runs if run.recording == recording]

    def named(self, recording: str, name: str) -> SlamRun | None:
        """The run with a name, None if there is none."""
        return next((run for run in self.of(recording) if run.name == name), None)
