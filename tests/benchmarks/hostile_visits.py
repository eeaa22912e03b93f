"""What hostile clients cost the other browsers and the workbench's server."""

import base64
import json
import os
import subprocess
import sys
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import websockets.exceptions

from scanloom.resources import sample_path
from scanloom.server.pages import LINK_KEY
from scanloom.state.view import View
from tests.app.viser_client import connect
from tests.hostile.visitors import (
    LAST_WIDGET,
    malformed_messages,
    open_silent_sockets,
    seconds_to_page,
)

ROOT = Path(__file__).parents[2]
ENOUGH_S = 120.0
# A report comes soon or not at all.
PATIENCE_S = 5.0
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


class Server:
    """The workbench on the built-in recording, aligned, in a process of its own."""

    def __init__(self, address: str, process: "subprocess.Popen[str]") -> None:
        self.address, self.process = address, process

    def cpu_s(self) -> float:
        """Seconds of work so far."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / _TICKS_PER_S

    def peak_mib(self) -> float:
        """The most memory that it has held."""
        lines = Path(f"/proc/{self.process.pid}/status").read_text().splitlines()
        return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))

    def said(self, link: str) -> str:
        """What a page that follows a link reports."""
        with connect(self.address, storage={LINK_KEY: link}) as client:
            try:
                reported = client.wait_for(
                    lambda received: received.type == "NotificationShowMessage", PATIENCE_S
                ).message["props"]
            except TimeoutError:
                return "nothing is reported"
            client.find(LAST_WIDGET, timeout=ENOUGH_S)
            return f"the page is served and says: {reported['title']} {reported['body']}"


@contextmanager
def served(folder: Path) -> Iterator[Server]:
    words = ["view", str(sample_path()), "--port=0", "--json", "-o", str(folder / "out")]
    with subprocess.Popen(
        [sys.executable, "-m", "scanloom", *words],
        env=dict(os.environ) | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            server = Server(json.loads(process.stdout.readline())["address"], process)
            seconds_to_page(server.address)
            yield server
        finally:
            process.terminate()


def link_with(name: str, value: object) -> str:
    """A link in which one value is another than a view can have; ``name`` with its tables."""
    link = View(recording=sample_path().name).to_link()
    values = json.loads(zlib.decompress(base64.urlsafe_b64decode(link + "==")))
    *tables, last = name.split(".")
    inside = values
    for table in tables:
        inside = inside.setdefault(table, {})
    inside[last] = value
    packed = zlib.compress(json.dumps(values).encode())
    return base64.urlsafe_b64encode(packed).decode().rstrip("=")


def silent_sockets(folder: Path) -> Iterator[tuple[str, float, float, str]]:
    """Call, seconds, memory in MiB, and what happened."""
    with served(folder) as server:
        for count in (0, 40, 70):
            with open_silent_sockets(server.address, count):
                times = seconds_to_page(server.address)
            yield (
                f"another browser's page beside {count} silent sockets",
                times.page_s,
                server.peak_mib(),
                f"page {times.page_s:.2f} s, widgets {times.widgets_s:.2f} s, "
                f"scene {times.scene_s:.2f} s",
            )


def endless_links(folder: Path) -> Iterator[tuple[str, float, float, str]]:
    """The same, of links to settings that make the work endless."""
    with served(folder) as server:
        begun_s = time.perf_counter()
        reported = [server.said(link_with("settings.mount.delta_z_min_m", -1e7)) for _ in range(6)]
        seconds = time.perf_counter() - begun_s
        before_s = server.cpu_s()
        time.sleep(3.0)
        idle = f"{server.cpu_s() - before_s:.2f} s of work in the 3 s after the last has left"
        yield (
            "six links with delta_z_min_m -1e7",
            seconds,
            server.peak_mib(),
            f"{reported[0]}; {idle}",
        )


def odd_links(folder: Path) -> Iterator[tuple[str, float, float, str]]:
    """The same, of links with numbers that no message holds."""
    with served(folder) as server:
        for value in (2**64, -(2**70), 10**400):
            begun_s = time.perf_counter()
            reported = server.said(link_with("beam", value))
            seconds = time.perf_counter() - begun_s
            yield (
                f"a link with beam {value:.0e}" if value < 2**80 else "a link with beam 1e400",
                (seconds),
                server.peak_mib(),
                reported,
            )


def malformed(folder: Path) -> Iterator[tuple[str, float, float, str]]:
    """The same, of messages that are none."""
    with served(folder) as server:
        begun_s = time.perf_counter()
        messages = malformed_messages()
        for _, data in messages:
            with connect(server.address, storage={}) as client:
                client.find("Preset", timeout=ENOUGH_S)
                with suppress(websockets.exceptions.ConnectionClosed):
                    client.send_bytes(data)
        seconds, peak_mib = time.perf_counter() - begun_s, server.peak_mib()
        times = seconds_to_page(server.address)
        server.process.terminate()
        _, errors = server.process.communicate()
        lines = errors.splitlines()
        yield (
            f"{len(messages)} malformed messages",
            seconds,
            peak_mib,
            f"{len(lines)} lines on stderr, {errors.count('Traceback')} tracebacks; "
            f"then a page in {times.page_s:.2f} s",
        )
