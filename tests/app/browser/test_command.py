"""The command itself, as a process of its own."""

import json
import re
import signal
import subprocess
import sys
from pathlib import Path
from urllib.request import urlopen

from tests.app.viser_client import ViserClient, connect
from tests.patience import ENOUGH_S

ROOT = Path(__file__).parents[3]


def test_the_command_serves_until_it_is_interrupted(small_scene: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "scanloom",
        "view",
        str(small_scene),
        "--port",
        "0",
        "--json",
    ]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as serving:
        assert serving.stdout is not None
        try:
            address = json.loads(serving.stdout.readline())["address"]
            assert re.fullmatch(r"http://127\.0\.0\.1:\d+", address)
            with urlopen(address, timeout=ENOUGH_S) as page:
                assert b"<html" in page.read()
            with connect(address) as client:
                title = f"<bdi>{small_scene.name}</bdi>"
                client.wait_until(lambda: any_content(client, title))
                serving.send_signal(signal.SIGINT)
                rest, errors = serving.communicate(timeout=ENOUGH_S)
        finally:
            serving.kill()
    assert (serving.returncode, rest, errors) == (0, "", "")


def any_content(client: ViserClient, words: str) -> bool:
    widgets = list(client.widgets.values())
    return any(words in str(widget.props.get("content")) for widget in widgets)
