"""Ctrl-C, and the signals like it, end work and servers well, whenever they come."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from scanloom.commands.interruption import Terminated, interruption, termination
from scanloom.resources import sample_path
from tests.app.viser_client import connect
from tests.patience import ENOUGH_S

ROOT = Path(__file__).parents[2]
ENDS_S = 60.0


@pytest.fixture
def own_handler() -> Iterator[list[int]]:
    """What Ctrl-C calls before and after; the signals that reached it."""
    reached: list[int] = []
    before = {
        each: signal.signal(each, lambda number, _: reached.append(number))
        for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    }
    yield reached
    for each, handler in before.items():
        signal.signal(each, handler)


def press() -> None:
    os.kill(os.getpid(), signal.SIGINT)


def test_within_it_is_noted_and_stays_without_effect(own_handler: list[int]) -> None:
    with interruption() as interrupted:
        assert not interrupted
        press()
        interrupted.wait()
        assert interrupted
        press()
    press()
    assert own_handler == []


def test_what_it_did_before_holds_again_where_it_was_not_pressed(own_handler: list[int]) -> None:
    with interruption():
        pass
    press()
    assert own_handler == [signal.SIGINT]


def test_a_failure_within_goes_on(own_handler: list[int]) -> None:
    with pytest.raises(ValueError, match="of this test"), interruption():
        raise ValueError("of this test")
    press()
    assert own_handler == [signal.SIGINT]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_work_ends_by_an_exception_and_cleans_up_undisturbed(number: signal.Signals) -> None:
    steps = []
    before = signal.getsignal(number)

    def work() -> None:
        try:
            os.kill(os.getpid(), number)
        finally:
            os.kill(os.getpid(), number)
            steps.append("cleaned up")

    with pytest.raises(Terminated) as ended, termination():
        work()
    assert (ended.value.number, steps) == (number, ["cleaned up"])
    assert signal.getsignal(number) is before


def test_what_is_ignored_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with termination():
            os.kill(os.getpid(), signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_command_that_is_ended_leaves_nothing(tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "scanloom", "fuse", str(sample_path()), "-o", str(out)]
    with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True) as running:
        assert running.stderr is not None
        try:
            # The folder is held from here on.
            assert any("reading" in line or "matching" in line for line in running.stderr)
            assert out.exists()
            running.send_signal(signal.SIGTERM)
            _, errors = running.communicate(timeout=ENOUGH_S)
        finally:
            running.kill()
    assert (running.returncode, errors.splitlines()[-1]) == (143, "ended by a signal")
    assert not out.exists()


def serving(recording: Path, port: int = 0, *more: str) -> subprocess.Popen[str]:
    command = [
        sys.executable,
        "-m",
        "scanloom",
        "view",
        str(recording),
        "--json",
        f"--port={port}",
    ]
    return subprocess.Popen(
        [*command, *more], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def ended(server: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Exit code, what is left of stdout, and stderr."""
    rest, errors = server.communicate(timeout=ENDS_S)
    return server.returncode, rest, errors


@pytest.mark.parametrize(
    "delay_s", [0.0, *(pytest.param(s, marks=pytest.mark.slow) for s in (0.002, 0.02, 0.2))]
)
def test_pressed_as_soon_as_the_address_is_printed(small_scene: Path, delay_s: float) -> None:
    with serving(small_scene) as server:
        assert server.stdout is not None
        try:
            address = json.loads(server.stdout.readline())["address"]
            time.sleep(delay_s)
            server.send_signal(signal.SIGINT)
            assert ended(server) == (0, "", "")
        finally:
            server.kill()
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+", address)


@pytest.mark.parametrize(
    "number", [signal.SIGTERM, pytest.param(signal.SIGHUP, marks=pytest.mark.slow)]
)
def test_a_build_that_is_ended_with_its_server_leaves_nothing(
    small_scene: Path, tmp_path: Path, number: signal.Signals
) -> None:
    root = tmp_path / "out"
    with serving(small_scene, 0, "-o", str(root)) as server:
        assert server.stdout is not None
        try:
            address = json.loads(server.stdout.readline())["address"]
            with connect(address) as client:
                client.find("Build")
                # A button takes clicks a moment after it is shown.
                deadline_s = time.monotonic() + ENOUGH_S
                while not any(root.glob("*/results")) and time.monotonic() < deadline_s:
                    client.click("Build")
                    time.sleep(0.01)
                server.send_signal(number)
                assert ended(server) == (0, "", "")
        finally:
            server.kill()
    assert list(root.iterdir()) == []


def test_pressed_as_soon_as_anything_listens(small_scene: Path) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with serving(small_scene, port) as server:
        try:
            assert accepts(port)
            server.send_signal(signal.SIGINT)
            code, rest, errors = ended(server)
        finally:
            server.kill()
    assert (code, errors) == (0, "")
    assert rest.count("\n") == 1


def test_pressed_again_and_again_while_it_closes(small_scene: Path) -> None:
    with serving(small_scene) as server:
        assert server.stdout is not None
        try:
            address = json.loads(server.stdout.readline())["address"]
            # A session that is being aligned, whose closing takes its time.
            with connect(address) as client:
                client.find("Frame")
                deadline_s = time.monotonic() + ENDS_S
                while server.poll() is None and time.monotonic() < deadline_s:
                    server.send_signal(signal.SIGINT)
                    time.sleep(0.01)
                assert ended(server) == (0, "", "")
        finally:
            server.kill()


def accepts(port: int) -> bool:
    """Whether something listens in time."""
    deadline_s = time.monotonic() + ENOUGH_S
    while time.monotonic() < deadline_s:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
        except OSError:
            time.sleep(0.001)
        else:
            return True
    return False
