"""The lost parts of a damaged MCAP file, and the warnings that report them."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import NS_PER_S, IntArray
from fusion_core.recordings.containers import Entries

_MAX_LISTED = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Lost:
    """A byte range that could not be read. First and last log time are None if unknown."""

    start: int
    end: int
    what: str
    start_ns: int | None = None
    end_ns: int | None = None


@dataclass(frozen=True, slots=True)
class _UndefinedChannel:
    """Messages of a channel that no record defines."""

    count: int
    start_ns: int
    end_ns: int


class Losses:
    """Collects what is lost, in the order of the file. ``breaks_off``: the file has no end."""

    def __init__(self) -> None:
        self.breaks_off = False
        self._lost: list[Lost] = []
        self._orphans: dict[int, _UndefinedChannel] = {}
        self._undefined = 0
        self._first_undefined = ""
        self._untimed = 0

    def __bool__(self) -> bool:
        return bool(
            self.breaks_off or self._lost or self._orphans or self._undefined or self._untimed
        )

    def add(self, lost: Lost) -> None:
        if lost.end > lost.start:
            self._lost.append(lost)

    def add_undefined_channel(self, channel: int, log_times_ns: IntArray) -> None:
        """(N,) log times of the messages of a channel that no record defines."""
        self._orphans[channel] = _UndefinedChannel(
            len(log_times_ns), int(log_times_ns.min()), int(log_times_ns.max())
        )

    def add_bad_definition(self, problem: str) -> None:
        """Add a schema or channel that cannot be read."""
        self._first_undefined = self._first_undefined or problem
        self._undefined += 1

    def add_untimed(self) -> None:
        """Count a message with an invalid log time."""
        self._untimed += 1

    def warnings(self, found: Entries, file_bytes: int) -> list[str]:
        """One line for each loss; log times count from the first message ``found``."""
        clock = _Clock(found)
        lines = [
            f"Lost are {lost.end - lost.start} bytes, from byte {lost.start} to {lost.end}"
            f"{clock.span(lost)}: {lost.what}."
            for lost in self._lost[:_MAX_LISTED]
        ]
        rest = self._lost[_MAX_LISTED:]
        if rest:
            size = sum(lost.end - lost.start for lost in rest)
            lines.append(
                f"Lost are {size} bytes more in {len(rest)} places, from byte {rest[0].start} to "
                f"{rest[-1].end}."
            )
        if self.breaks_off:
            last = f" {clock.text(clock.last_ns)} after its start" if len(found) else ""
            lines.append(f"The file breaks off{last}, at byte {file_bytes}.")
        orphans = sorted(self._orphans.items())
        lines += [
            f"{lost.count} messages from {clock.text(lost.start_ns)} to {clock.text(lost.end_ns)} "
            f"are left out: the record of their channel {channel} cannot be read."
            for channel, lost in orphans[:_MAX_LISTED]
        ]
        if orphans[_MAX_LISTED:]:
            count = sum(lost.count for _, lost in orphans[_MAX_LISTED:])
            lines.append(
                f"{count} messages of {len(orphans) - _MAX_LISTED} more channels are left out."
            )
        if self._undefined:
            lines.append(
                f"{self._undefined} schemas or channels cannot be read; "
                f"the first, {self._first_undefined}."
            )
        if self._untimed:
            lines.append(f"{self._untimed} messages are left out: their log times are none.")
        return lines


class _Clock:
    """Log times as seconds after the first message found."""

    def __init__(self, found: Entries) -> None:
        self._places = np.where(found["block"] < 0, found["offset"], found["block"])
        self._times = found["received_ns"]
        self._first_ns = int(self._times.min()) if len(found) else 0
        self.last_ns = int(self._times.max()) if len(found) else 0

    def text(self, ns: int) -> str:
        # Adding 0.0 makes a negative zero positive.
        return f"{round((ns - self._first_ns) / NS_PER_S, 3) + 0.0:.3f} s"

    def span(self, lost: Lost) -> str:
        """The log times of a loss, or of the messages around it."""
        if lost.start_ns is not None and lost.end_ns is not None and lost.start_ns <= lost.end_ns:
            return f", from {self.text(lost.start_ns)} to {self.text(lost.end_ns)}"
        before = int(np.searchsorted(self._places, lost.start))
        behind = int(np.searchsorted(self._places, lost.end))
        bounds = []
        if before:
            bounds.append(f"after {self.text(int(self._times[before - 1]))}")
        if behind < len(self._times):
            bounds.append(f"before {self.text(int(self._times[behind]))}")
        return f", {' and '.join(bounds)}" if bounds else ""
