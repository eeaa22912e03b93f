"""A socket of its own for each upload, beside viser's: parts of a file, counted as they come.

viser's own upload keeps whole files in memory and has no limit; its messages stay refused. The
guard checks these sockets as it checks viser's, and the page knows its session's ticket.
"""

import asyncio
from urllib.parse import parse_qs

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from scanloom.server.connections import ClientConnection
from scanloom.state.uploads import SessionUploads, Upload, UploadRefused, Uploads

UPLOAD_PATH = "/upload"
# Longer than browsers pause between parts on a bad line.
_PART_TIMEOUT_S = 30.0
_REFUSED = 1008
_CLOSE_REASON = "refused"


class _Announcement(BaseModel):
    """The first message: the file's name, which is only shown, and its size."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(max_length=4096)
    size: int = Field(ge=0, le=2**53)


async def receive_upload(connection: ServerConnection, uploads: Uploads) -> None:
    """Take one file: its announcement, "go", then its bytes in messages of any length."""
    session = _session_of(connection, uploads)
    if session is None:
        await connection.close(_REFUSED, _CLOSE_REASON)
        return
    if isinstance(connection, ClientConnection):
        connection.take_any_message()
    try:
        complete = await _receive(connection, session)
    except (ConnectionClosed, TimeoutError):
        return
    await connection.close(1000 if complete else _REFUSED, "" if complete else _CLOSE_REASON)


async def _receive(connection: ServerConnection, session: SessionUploads) -> bool:
    """Whether the file was kept. The session's listener hears of all that a person should know."""
    try:
        first = await asyncio.wait_for(connection.recv(), _PART_TIMEOUT_S)
        announced = _Announcement.model_validate_json(first)
    except ValidationError:
        return False
    try:
        # Files are written in threads: the event loop serves all browsers.
        upload = await asyncio.to_thread(session.begin, announced.name, announced.size)
    except UploadRefused as error:
        await asyncio.to_thread(session.listener.on_refused, error)
        return False
    try:
        await connection.send("go")
        await _receive_parts(connection, upload)
    except UploadRefused as error:
        await asyncio.to_thread(upload.refuse, error)
        return False
    except (ConnectionClosed, TimeoutError):
        broken_off = UploadRefused(f"{upload.label}: the upload broke off.", advice="Try again.")
        await asyncio.to_thread(upload.refuse, broken_off)
        return False
    except BaseException:
        session.end(upload)
        raise
    return True


async def _receive_parts(connection: ServerConnection, upload: Upload) -> None:
    while not upload.is_complete:
        part = await asyncio.wait_for(connection.recv(), _PART_TIMEOUT_S)
        if not isinstance(part, bytes):
            raise UploadRefused(f"{upload.label}: the upload was garbled.", advice="Try again.")
        await asyncio.to_thread(upload.write, part)
    await asyncio.to_thread(upload.finish)


def _session_of(connection: ServerConnection, uploads: Uploads) -> SessionUploads | None:
    request = connection.request
    query = "" if request is None else request.path.partition("?")[2]
    tickets = parse_qs(query).get("ticket", [])
    return uploads.session(tickets[0]) if len(tickets) == 1 else None
