"""Uploads through the server's own socket: what is taken, what is refused, and that viser's
connection outlives either."""

import bz2
import json
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import websockets.exceptions
import websockets.sync.client

from scanloom.server.workbench import ServeOptions, Workbench
from tests.app.viser_client import ViserClient, connect
from tests.patience import ENOUGH_S, comes_true

LIMIT = 20_000_000
FAILED = 'data-kind="failed" role="status"'


@pytest.fixture(scope="module")
def temporary(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The system's folder of temporary files."""
    folder = tmp_path_factory.mktemp("temporary")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tempfile.tempdir", str(folder))
        yield folder


@pytest.fixture(scope="module")
def workbench(
    small_scene: Path, temporary: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Workbench]:
    options = ServeOptions(
        recordings=[small_scene],
        port=0,
        output_root=tmp_path_factory.mktemp("out"),
        upload_limit_bytes=LIMIT,
    )
    with Workbench(options) as serving:
        yield serving


@pytest.fixture
def client(workbench: Workbench) -> Iterator[ViserClient]:
    with connect(workbench.address, storage={}) as client:
        assert comes_true(lambda: shown(workbench) == 1)
        yield client
    assert comes_true(lambda: workbench.sessions == [])


def shown(workbench: Workbench) -> int:
    """How many sessions show something."""
    return sum(session.frame_view is not None for session in workbench.sessions)


def text_of(client: ViserClient) -> str:
    return "".join(str(w.props.get("content") or "") for w in list(client.widgets.values()))


def ticket_of(client: ViserClient) -> str:
    pattern = re.compile(r'data-upload="([\w-]+)"')
    client.wait_until(lambda: pattern.search(text_of(client)) is not None)
    found = pattern.search(text_of(client))
    assert found is not None
    return found.group(1)


def socket_of(
    workbench: Workbench, ticket: str, **options: Any
) -> websockets.sync.client.ClientConnection:
    place = workbench.address.removeprefix("http://")
    return websockets.sync.client.connect(
        f"ws://{place}/upload?ticket={ticket}",
        origin=options.pop("origin", f"http://{place}"),
        compression=None,
        proxy=None,
        **options,
    )


def upload(workbench: Workbench, client: ViserClient, name: str, content: bytes) -> None:
    with socket_of(workbench, ticket_of(client)) as socket:
        socket.send(json.dumps({"name": name, "size": len(content)}))
        assert socket.recv(ENOUGH_S) == "go"
        for at in range(0, len(content), 100_000):
            socket.send(content[at : at + 100_000])
        with pytest.raises(websockets.exceptions.ConnectionClosed):
            socket.recv(ENOUGH_S)


def says(client: ViserClient, words: str) -> None:
    client.wait_until(lambda: words in text_of(client))


def works(client: ViserClient) -> None:
    """The page answers."""
    client.press("open-dismiss", "")
    client.wait_until(lambda: FAILED not in text_of(client))


def kept(temporary: Path) -> list[Path]:
    return [path for path in temporary.rglob("*") if path.is_file()]


def test_a_recording_is_taken_and_opened_and_goes_with_its_page(
    workbench: Workbench, small_scene: Path, temporary: Path
) -> None:
    with connect(workbench.address, storage={}) as client:
        assert comes_true(lambda: shown(workbench) == 1)
        name = '../../<img src=x onerror="window.taken=1">.mcap'
        upload(workbench, client, name, small_scene.read_bytes())
        (session,) = workbench.sessions
        assert comes_true(
            lambda: session.frame_view is not None and "upload" in session.frame_view.view.recording
        )
        assert session.frame_view is not None
        path = session.frame_view.open_recording.fuse_session.recording.path
        assert path.parent.parent == temporary
        assert session.frame_view.view.recording.startswith(name)
        assert "<img src=x" not in text_of(client)
        # What was uploaded for one page is not remembered for others.
        assert name not in client.storage.get("recent", "")
        assert len(kept(temporary)) == 1
    assert comes_true(lambda: kept(temporary) == [])


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("notes.txt", b"no recording at all\n", "notes.txt: is no recording: a text file."),
        ("a.zip", b"PK\x03\x04" + b"x" * 100, "a.zip: is no recording: a ZIP archive"),
        # 200 MB of one letter in some kB, and its first lines are those of a log.
        (
            "bomb.clf.bz2",
            bz2.compress(b"PARAM robot_x 1\n") + 200 * bz2.compress(b"A" * 1_000_000),
            "bomb.clf.bz2: ",
        ),
    ],
)
def test_what_is_no_recording_is_refused_and_deleted(
    workbench: Workbench,
    client: ViserClient,
    temporary: Path,
    name: str,
    content: bytes,
    words: str,
) -> None:
    (session,) = workbench.sessions
    before = session.view
    upload(workbench, client, name, content)
    says(client, words)
    says(client, FAILED)
    assert comes_true(lambda: kept(temporary) == [])
    assert session.view == before
    works(client)


def test_two_gigabytes_are_refused_at_once(
    workbench: Workbench, client: ViserClient, temporary: Path
) -> None:
    with socket_of(workbench, ticket_of(client)) as socket:
        socket.send(json.dumps({"name": "huge.bag", "size": 2_000_000_000}))
        with pytest.raises(websockets.exceptions.ConnectionClosed):
            socket.recv(ENOUGH_S)
    says(client, "huge.bag has 2,000 MB; at most 20 MB can be uploaded.")
    assert kept(temporary) == []
    works(client)


@pytest.mark.parametrize(
    "first",
    [
        "no JSON",
        "{}",
        json.dumps({"name": "a", "size": -1}),
        json.dumps({"name": "a", "size": 1.5}),
        json.dumps({"name": "a" * 5_000, "size": 1}),
        json.dumps({"name": "a", "size": 1, "path": "/etc/passwd"}),
        b"\xff\xff",
    ],
)
def test_what_is_no_announcement_ends_the_socket_alone(
    workbench: Workbench, client: ViserClient, temporary: Path, first: str | bytes
) -> None:
    with socket_of(workbench, ticket_of(client)) as socket:
        socket.send(first)
        with pytest.raises(websockets.exceptions.ConnectionClosed):
            socket.recv(ENOUGH_S)
    assert kept(temporary) == []
    works(client)


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ([b"x" * 60, b"x" * 60], "a.mcap is larger than announced."),
        (["text"], "a.mcap: the upload was garbled."),
        ([b"x" * 60], "a.mcap: the upload broke off."),
        ([], "a.mcap: the upload broke off."),
    ],
)
def test_an_upload_that_goes_wrong_is_deleted(
    workbench: Workbench,
    client: ViserClient,
    temporary: Path,
    parts: list[str | bytes],
    words: str,
) -> None:
    with socket_of(workbench, ticket_of(client)) as socket:
        socket.send(json.dumps({"name": "a.mcap", "size": 100}))
        assert socket.recv(ENOUGH_S) == "go"
        for part in parts:
            socket.send(part)
    says(client, words)
    assert comes_true(lambda: kept(temporary) == [])
    works(client)


def test_a_part_of_more_than_the_servers_limit_ends_the_socket(
    workbench: Workbench, client: ViserClient, temporary: Path
) -> None:
    with socket_of(workbench, ticket_of(client)) as socket:
        socket.send(json.dumps({"name": "a.mcap", "size": LIMIT}))
        assert socket.recv(ENOUGH_S) == "go"
        # It may be closed before all is sent, or after.
        with suppress(websockets.exceptions.ConnectionClosed):
            socket.send(b"x" * 5_000_000)
        with pytest.raises(websockets.exceptions.ConnectionClosed):
            socket.recv(ENOUGH_S)
    says(client, "the upload broke off")
    assert comes_true(lambda: kept(temporary) == [])
    works(client)


def test_nobody_uploads_without_a_ticket(workbench: Workbench, client: ViserClient) -> None:
    for ticket in ("", "x", f"{ticket_of(client)}x", f"{ticket_of(client)}&ticket=x"):
        with (
            socket_of(workbench, ticket) as socket,
            pytest.raises(websockets.exceptions.ConnectionClosed),
        ):
            socket.recv(ENOUGH_S)
    with pytest.raises(websockets.exceptions.InvalidStatus, match="403"):
        socket_of(workbench, ticket_of(client), origin="http://evil.example")
