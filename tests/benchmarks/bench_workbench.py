"""How soon the workbench answers, from a slider's message to the new picture's message.

    python -m tests.benchmarks.bench_workbench

Over the real socket, with a browser's part of the protocol and no page. The server is a process of
its own, held to two cores, which the browsers share where the machine has no others. Before each
change that is measured the frame is changed too, so that no result is at hand. Exits with 1 where
an aim is missed.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random
from typing import Any, Self

import numpy as np

from fusion_core.simulation.scenes import SceneSettings, find_scene, write_scene
from fusion_core.workflows.fuse.settings import PRESETS
from scanloom.resources import sample_path
from tests.app.viser_client import Received, ViserClient, connect
from tests.benchmarks.page_agreement import PageContent

CORES = 2
CHANGES = 100
PEOPLE = 4
EVENTS, EVENTS_S, EVENT_ROUNDS = 200, 2.0, 5
PLAYED_S = 10.0
PANORAMA_S = 4.0
# Images a second in the sample.
OWN_HZ = 15.0
# Of one frame more or less at both ends.
_RATE_TOLERANCE = 0.97
_COUNTED_WITHIN_S = 300.0
_QUIET_S = 0.2
_ALIGNED_WITHIN_S = 300.0
_STEPS_DEG = tuple(0.5 + 0.25 * step for step in range(11))
# To and fro: a picture that comes out the same is not sent again.
_OVERLAPS = tuple(low + side for low in (0.2, 0.25, 0.3, 0.35, 0.15) for side in (0.0, 0.6))
_EPSILONS = tuple(low + side for low in (0.5, 0.7, 0.9, 1.1, 1.3) for side in (0.0, 5.0))

# Where the picture stands that a panel is about.
_PICTURES = {"Match": "Where do they fit?", "Repair": "Depth image"}

IsPicture = Callable[[Received], bool]


@dataclass(frozen=True, slots=True)
class Figure:
    """A row of the table: what was measured, in words, and whether it meets the aim."""

    name: str
    text: str
    aim: str
    is_met: bool


class Browser:
    """One person's connection, with a panel open and its first picture there."""

    def __init__(self, address: str, panel: str, *, first_frame: int = 0) -> None:
        self.client: ViserClient = connect(address)
        self._random = Random(first_frame)
        self._frame = first_frame
        self._panel = panel
        self.client.find("page events", timeout=60.0)
        self.client.wait_until(self._is_aligned, _ALIGNED_WITHIN_S)
        self.client.press("step", panel)
        self.settle()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.client.close()

    @property
    def frames(self) -> int:
        """How many frames the recording has."""
        return int(self.client.find("Frame").props["max"])

    def settle(self) -> list[Received]:
        """What comes until nothing has for a while, and a little longer: not in step with the
        server."""
        received = []
        while True:
            try:
                received.append(self.client.receive(_QUIET_S))
            except TimeoutError:
                break
        time.sleep(self._random.uniform(0.0, 0.02))
        return received

    def go_on(self) -> None:
        """To the next frame, until it is shown."""
        self._frame = (self._frame + 1) % self.frames
        self.client.set_value("Frame", self._frame + 1)
        self.settle()

    def picture(self) -> IsPicture:
        """Whether a message brings a new picture of what the open panel is about."""
        place = _PICTURES[self._panel]
        uuid = next(
            widget.uuid
            for widget in self.client.widgets.values()
            if widget.type == "GuiImageMessage" and place in self.client.around(widget)
        )
        return lambda received: (
            received.type == "GuiUpdateMessage"
            and received.message["uuid"] == uuid
            and "_data" in received.message["updates"]
        )

    def says(self, text: str) -> bool:
        """Whether some line of the page begins or goes on so."""
        return any(
            text in str(widget.props.get("content"))
            for widget in list(self.client.widgets.values())
        )

    def answer_ms(self, label: str, value: Any) -> float:
        """From a change of a widget in the open panel to the picture that comes of it."""
        is_picture = self.picture()
        sent_s = self.client.set_value(label, value)
        return 1e3 * (self.client.wait_for(is_picture, 20.0).arrived_s - sent_s)

    def answers_ms(self, label: str, values: Sequence[float], changes: int) -> list[float]:
        """So many changes, each in another frame."""
        times_ms = []
        for change in range(changes):
            self.go_on()
            times_ms.append(self.answer_ms(label, values[change % len(values)]))
            self.settle()
        return times_ms

    def _is_aligned(self) -> bool:
        return any(
            "frames are averaged in the recording's field" in str(widget.props.get("_markdown", ""))
            for widget in self.client.widgets.values()
        )


@dataclass(frozen=True, slots=True)
class Server:
    """A workbench that runs as a process of its own."""

    address: str
    pid: int


@contextmanager
def serving(recording: Path) -> Iterator[Server]:
    """``scanloom view`` with this recording."""
    command = [sys.executable, "-m", "scanloom", "view", str(recording), "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None, "it is piped"
    try:
        os.sched_setaffinity(process.pid, sorted(os.sched_getaffinity(0))[:CORES])
        yield Server(process.stdout.readline().strip(), process.pid)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(30.0)


def latency(name: str, times_ms: Sequence[float], aim_ms: float) -> Figure:
    median_ms, high_ms = np.percentile(times_ms, [50.0, 95.0])
    text = f"median {median_ms:6.1f} ms, 95 % within {high_ms:6.1f} ms"
    return Figure(name, text, f"95 % within {aim_ms:.0f} ms", bool(high_ms <= aim_ms))


def searching(browser: Browser, where: str, aim_ms: float) -> Iterator[Figure]:
    """Settings of sampling and search against the heatmap."""
    for label, values in (("Minimum overlap", _OVERLAPS), ("Sampling step (°)", _STEPS_DEG)):
        times_ms = browser.answers_ms(label, values, CHANGES)
        yield latency(f"{where}: {label.lower()} to heatmap", times_ms, aim_ms)
    browser.answer_ms("Sampling step (°)", 1.0)
    browser.settle()
    # As at first: where much overlap is asked for, many frames of a panorama have no score, and a
    # heatmap that stays the same is not sent again.
    browser.client.set_value("Minimum overlap", PRESETS["default"].search.min_overlap)
    browser.settle()


def together(address: str, aim_ms: float) -> Figure:
    """Four people who do the same at once, in frames of their own."""

    def one(browser: Browser) -> list[float]:
        return browser.answers_ms("Minimum overlap", _OVERLAPS, CHANGES // PEOPLE)

    with ExitStack() as stack:
        browsers = [
            stack.enter_context(Browser(address, "Match", first_frame=22 * person))
            for person in range(PEOPLE)
        ]
        with ThreadPoolExecutor(PEOPLE) as pool:
            all_ms = [time_ms for times_ms in pool.map(one, browsers) for time_ms in times_ms]
    return latency(f"sample, {PEOPLE} browsers: minimum overlap to heatmap", all_ms, aim_ms)


def judging(address: str, where: str, aim_ms: float) -> Figure:
    """Epsilon against the picture of the Repair panel."""
    with Browser(address, "Repair") as browser:
        times_ms = browser.answers_ms("ε (σ)", _EPSILONS, CHANGES)
    return latency(f"{where}: epsilon to repair picture", times_ms, aim_ms)


def playing(browser: Browser, where: str, aim_hz: float) -> Figure:
    """Pictures a second while the frames go by as fast as they can."""
    browser.client.press("timeline", "speed 4")
    browser.settle()
    is_picture = browser.picture()
    browser.client.press("timeline", "play")
    time.sleep(1.0)
    browser.client.drain()
    time.sleep(PLAYED_S)
    pictures = sum(map(is_picture, browser.client.drain()))
    browser.client.press("timeline", "play")
    browser.settle()
    rate_hz = pictures / PLAYED_S
    name = f"{where}: playing, heatmap on"
    return Figure(name, f"{rate_hz:.1f} pictures/s", f"{aim_hz:.0f} pictures/s", rate_hz >= aim_hz)


def playing_in_step(browser: Browser, where: str) -> Iterator[Figure]:
    """At the recording's own rate: how many frames are shown, and whether all views agree."""
    client, content = browser.client, PageContent()
    client.wait_until(lambda: not browser.says("counting noise"), _COUNTED_WITHIN_S)
    client.drain()
    # The first ones again: until then what hidden views hold is not of this round.
    for index in [*range(1, browser.frames), 0, 1]:
        client.set_value("Frame", index + 1)
        client.wait_until(partial(browser.says, f"Frame {index + 1} of"), _COUNTED_WITHIN_S)
        content.learn(browser.settle(), index)
    client.press("timeline", "speed 1")
    browser.settle()
    client.press("timeline", "play")
    time.sleep(1.0)
    content.take(client.drain())
    time.sleep(PLAYED_S)
    found = content.judge(client.drain())
    client.press("timeline", "play")
    browser.settle()
    rate_hz = len(found.frames) / PLAYED_S
    name = f"{where}: playing at its own rate"
    text = f"{rate_hz:.1f} frames/s, {found.most_messages} messages and "
    text += f"{found.most_bytes / 1e3:.0f} kB a frame at most"
    yield Figure(name, text, f"{OWN_HZ:.0f} frames/s", rate_hz >= _RATE_TOLERANCE * OWN_HZ)
    text = f"{found.worst} frames apart at most, {found.parts} views"
    yield Figure(f"{where}: views while playing", text, "0 apart", found.worst == 0)


def dragging(browser: Browser) -> Figure:
    """A slider dragged wildly must end in its last value's picture, and stay where it is."""
    label, client = "Minimum overlap", browser.client
    slider = client.find(label).uuid
    is_picture = browser.picture()
    right = pictures = moved = 0
    waited_ms = []
    for round_ in range(EVENT_ROUNDS):
        browser.go_on()
        client.drain()
        last = _OVERLAPS[2 * round_ + 1]
        values = [value for value in _OVERLAPS if value != last] * EVENTS
        begin_s = time.perf_counter()
        for event, value in enumerate([*values[: EVENTS - 1], last]):
            time.sleep(max(begin_s + event * EVENTS_S / EVENTS - time.perf_counter(), 0.0))
            sent_s = client.set_value(label, value)
        time.sleep(0.5)
        received = client.drain()
        found = [one for one in received if is_picture(one)]
        pictures += len(found)
        moved += sum(_sets_value(one, slider) for one in received)
        waited_ms.append(1e3 * (found[-1].arrived_s - sent_s))
        # The same value again, with nothing else going on.
        for value in (0.5, _OVERLAPS[0], last):
            client.set_value(label, value)
            fresh = [one for one in browser.settle() if is_picture(one)]
        right += bool(fresh) and _data(found[-1]) == _data(fresh[-1])
    text = (
        f"{right} of {EVENT_ROUNDS} right, {max(waited_ms):.0f} ms after the last at most, "
        f"{pictures / EVENT_ROUNDS:.0f} pictures each, slider moved {moved} times"
    )
    name = f"sample: {EVENTS} events in {EVENTS_S:g} s"
    return Figure(name, text, "the last value's picture", right == EVENT_ROUNDS and not moved)


def _sets_value(received: Received, uuid: str) -> bool:
    message = received.message
    return (
        received.type == "GuiUpdateMessage"
        and message["uuid"] == uuid
        and "value" in message["updates"]
    )


def _data(received: Received) -> bytes:
    return bytes(received.message["updates"]["_data"])


def write_panorama(path: Path) -> None:
    """Four cameras in portrait, 960 x 320 together."""
    own = find_scene("robot_at_home").settings.model_dump()
    write_scene("robot_at_home", path, settings=SceneSettings(**own | {"duration_s": PANORAMA_S}))


def figures(panorama: Path) -> Iterator[Figure]:
    """All rows of the table."""
    with serving(sample_path()) as server:
        with Browser(server.address, "Match") as browser:
            yield from searching(browser, "sample", 100.0)
            yield playing(browser, "sample", 15.0)
            yield dragging(browser)
        with Browser(server.address, "Repair") as browser:
            yield from playing_in_step(browser, "sample")
        yield judging(server.address, "sample", 50.0)
        yield together(server.address, 200.0)
    with serving(panorama) as server:
        with Browser(server.address, "Match") as browser:
            yield from searching(browser, "panorama", 200.0)
            yield playing(browser, "panorama", 15.0)
        yield judging(server.address, "panorama", 50.0)


def main() -> None:
    """Print the table; exit 1 where an aim is missed."""
    is_met = True
    with tempfile.TemporaryDirectory() as folder:
        panorama = Path(folder) / "panorama.mcap"
        write_panorama(panorama)
        print(f"{CHANGES} changes each; server on {CORES} cores")
        for figure in figures(panorama):
            is_met &= figure.is_met
            missed = "" if figure.is_met else "  MISSED"
            print(f"{figure.name:<48}{figure.text}  (aim: {figure.aim}){missed}", flush=True)
    sys.exit(not is_met)


if __name__ == "__main__":
    main()
