"""Files that a panel has written, for the browser to keep."""

from pathlib import Path

from fusion_core.model.errors import ExportError
from scanloom.client_session import ClientSession


def send_saved_file(session: ClientSession, path: Path) -> None:
    """Have the browser save a file under its folder's and its own name, or show why not."""
    try:
        content = path.read_bytes()
    except OSError as error:
        problem = f"cannot be read: {error.strerror or error}."
        session.show_failure(ExportError(problem, file=path))
        return
    session.send_file(f"{path.parent.name}-{path.name}", content)
