"""A server of PostgreSQL in a folder of its own, on a free port of the loopback."""

import os
import pwd
import shutil
import socket
import subprocess
from collections.abc import Sequence
from pathlib import Path

PASSWORD = "correct-horse"
_OWNER = "postgres"


def find_programs() -> Path | None:
    """The folder of initdb and pg_ctl: on the PATH, or where Debian keeps those of each version."""
    found = shutil.which("initdb")
    folders = [Path(found).parent] if found else []
    folders += sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
    return next((folder for folder in folders if (folder / "pg_ctl").exists()), None)


def may_run() -> bool:
    """The server refuses to run as root, and is then run as Debian's user for it."""
    if os.geteuid():
        return True
    try:
        pwd.getpwnam(_OWNER)
    except KeyError:
        return False
    return _runuser() is not None


def _runuser() -> str | None:
    """Debian's own, which stands with what only root calls."""
    folders = [os.environ.get("PATH", os.defpath), "/usr/sbin", "/sbin"]
    return shutil.which("runuser", path=os.pathsep.join(folders))


class Server:
    """Made in an empty folder, not started."""

    def __init__(self, programs: Path, folder: Path, *, flushes: bool = False) -> None:
        """``flushes``: whether commits survive the machine's end too, not only the server's."""
        self._programs = programs
        self._data = folder / "data"
        self._log = folder / "log"
        self._options = "" if flushes else "-F"
        self.port = _free_port()
        password = folder / "password"
        password.write_text(PASSWORD)
        if not os.geteuid():
            shutil.chown(folder, _OWNER)
            shutil.chown(password, _OWNER)
        self._run(
            "initdb",
            *("--pgdata", str(self._data), "--username", "scanloom", "--encoding", "UTF8"),
            *("--auth", "scram-sha-256", "--pwfile", str(password), "--no-instructions"),
        )

    def start(self) -> None:
        """Start it, and wait until it answers."""
        options = f"{self._options} -h 127.0.0.1 -p {self.port} -k ''"
        self._control("start", "-o", options, "-l", str(self._log))

    def stop(self, mode: str = "fast") -> None:
        """Stop it; ``immediate`` is as if it were killed."""
        self._control("stop", "-m", mode)

    def address(self, database: str) -> str:
        """Of a database of this server."""
        return f"postgresql://scanloom:{PASSWORD}@127.0.0.1:{self.port}/{database}"

    def _control(self, *arguments: str) -> None:
        self._run("pg_ctl", "--pgdata", str(self._data), "--wait", *arguments)

    def _run(self, program: str, *arguments: str) -> None:
        command: Sequence[str] = (str(self._programs / program), *arguments)
        if not os.geteuid():
            command = (str(_runuser()), "-u", _OWNER, "--", *command)
        # The server lives on with what it inherits: no pipe may wait for its end.
        subprocess.run(
            command,
            cwd="/",
            check=True,
            timeout=60,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
