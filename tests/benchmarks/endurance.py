"""Whether the workbench's memory stays constant while four people watch for a long time.

    python -m tests.benchmarks.endurance [--minutes 30]

The server is a process of its own with the built-in recording. Each browser has another panel open
and plays in a loop. What is kept of frames fills up in the first minutes, so growth counts from the
fifth on. Exits with 1 where memory grows by more than the bar, or where a browser saw no pictures.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from scanloom.resources import sample_path
from scanloom.state.view import PanelName
from tests.app.viser_client import Received
from tests.benchmarks.bench_workbench import Browser, serving

WATCHED: tuple[PanelName, ...] = ("Match", "Register", "Repair", "Recording")
FILLED_MINUTES = 5
GROWTH_MAX = 0.05
_DRAINED_EACH_S = 0.25


def resident_mib(pid: int) -> float:
    """What a process holds in memory."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    (kib,) = [line.split()[1] for line in lines if line.startswith("VmRSS:")]
    return int(kib) / 1024.0


def is_picture(received: Received) -> bool:
    """Whether a message brings a new picture of the panel that is open."""
    return received.type == "GuiUpdateMessage" and "_data" in received.message["updates"]


def play(browser: Browser) -> None:
    """Play in a loop, as fast as it goes."""
    browser.client.press("timeline", "speed 4")
    browser.client.set_value("Loop", True)
    browser.client.press("timeline", "play")


def pictures_until(browsers: Sequence[Browser], end_s: float) -> list[int]:
    """Pictures that each browser gets until then. Sockets are read by threads of their own; what
    they leave is taken often, so that this process stays small."""
    pictures = [0] * len(browsers)
    while time.monotonic() < end_s:
        time.sleep(_DRAINED_EACH_S)
        for place, browser in enumerate(browsers):
            pictures[place] += sum(map(is_picture, browser.client.drain()))
    return pictures


def main() -> None:
    """Print a line a minute; exit 1 where the bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=int, default=30)
    minutes = parser.parse_args().minutes
    if minutes <= FILLED_MINUTES:
        print(f"a trial: growth counts from minute {FILLED_MINUTES} on and is not judged")
    memory_mib = []
    all_saw = True
    with serving(sample_path()) as server, ExitStack() as stack:
        browsers = [stack.enter_context(Browser(server.address, panel)) for panel in WATCHED]
        for browser in browsers:
            play(browser)
        print(f"{'minute':>6}{'memory MiB':>12}" + "".join(f"{panel:>11}" for panel in WATCHED))
        begin_s = time.monotonic()
        for minute in range(1, minutes + 1):
            pictures = pictures_until(browsers, begin_s + 60.0 * minute)
            memory_mib.append(resident_mib(server.pid))
            all_saw &= all(pictures)
            counts = "".join(f"{count:11d}" for count in pictures)
            print(f"{minute:6d}{memory_mib[-1]:12.1f}{counts}", flush=True)
    growth = 0.0
    if minutes > FILLED_MINUTES:
        growth = memory_mib[-1] / memory_mib[FILLED_MINUTES - 1] - 1.0
        span = f"from minute {FILLED_MINUTES} to {minutes}"
        print(f"growth {span}: {growth:+.1%}, at most {GROWTH_MAX:+.0%}")
    if not all_saw:
        print("a browser saw no pictures for a minute")
    sys.exit(growth > GROWTH_MAX or not all_saw)


if __name__ == "__main__":
    main()
