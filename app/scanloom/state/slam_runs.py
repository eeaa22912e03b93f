"""One person's runs of SLAM: the last few, and which of them are looked at."""

import threading

from scanloom.jobs.slam_run import SlamRun

MOST_RUNS = 8


class SlamRuns:
    """The runs of one browser, oldest first. Safe for threads.

    Whoever adds one beyond ``MOST_RUNS`` gets the oldest back, to be cleared away.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._runs: list[SlamRun] = []
        self._count = 0

    def next_number(self) -> int:
        """A number that no other run of this browser has, or had."""
        with self._lock:
            self._count += 1
            return self._count

    def add(self, run: SlamRun) -> SlamRun | None:
        """Keep a run; returns the one that had to go for it."""
        with self._lock:
            self._runs.append(run)
            return self._runs.pop(0) if len(self._runs) > MOST_RUNS else None

    def of(self, recording: str) -> list[SlamRun]:
        """Those of one recording."""
        with self._lock:
            return [run for run in self._runs if run.recording == recording]

    def named(self, recording: str, name: str) -> SlamRun | None:
        """The run with a name, None where it is none, or no more."""
        return next((run for run in self.of(recording) if run.name == name), None)
