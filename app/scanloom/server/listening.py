"""Where the server may listen: an address of this machine, and a free port of it."""

import errno
import os
import socket

from fusion_core.model.errors import SettingsError

LAST_PORT = 65_535
# viser looks no further for a free one.
_MOST_TRIED = 1000


def free_port(host: str, port: int) -> int:
    """The port, or the next one that is free; any with 0.

    viser itself waits for ever for an address that cannot be had, and for a port after the last.

    Raises SettingsError for an address that is not this machine's, and for a port that may not be
    had.
    """
    addresses = _addresses(host)
    if port == 0:
        _bind(host, addresses, 0)
        return 0
    for tried in range(port, min(port + _MOST_TRIED, LAST_PORT + 1)):
        if _bind(host, addresses, tried):
            return tried
    raise SettingsError(
        f"--port {port}: it is taken, and so are those after it.", advice="Name another, or 0."
    )


def _addresses(host: str) -> list[tuple[socket.AddressFamily, str]]:
    try:
        found = socket.getaddrinfo(
            host or None, 0, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )
    except OSError as error:
        raise _not_ours(host, error.strerror or str(error)) from error
    except ValueError as error:
        # Of more signs than a name can have, or others.
        raise _not_ours(host, "it is no name of a machine") from error
    return [(family, str(address[0])) for family, _, _, _, address in found]


def _bind(host: str, addresses: list[tuple[socket.AddressFamily, str]], port: int) -> bool:
    """Whether a port is free on all addresses. Raises SettingsError where none will do."""
    for family, address in addresses:
        try:
            with socket.socket(family, socket.SOCK_STREAM) as probe:
                # As the server does: what a connection has just left is free.
                if os.name == "posix":
                    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                if family == socket.AF_INET6:
                    probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                probe.bind((address, port))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                return False
            if error.errno in (errno.EACCES, errno.EPERM):
                raise SettingsError(
                    f"--port {port}: it may not be listened on ({error.strerror}).",
                    advice="Ports below 1024 are the system's: name a higher one.",
                ) from error
            raise _not_ours(host, error.strerror or str(error)) from error
    return True


def _not_ours(host: str, reason: str) -> SettingsError:
    return SettingsError(
        f"--host {host[:80]}: cannot be listened on ({reason}).",
        advice="Name an address of this machine, such as 127.0.0.1.",
    )
