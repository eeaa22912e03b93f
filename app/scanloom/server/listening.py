"""Checks the address to listen on, and finds a free port."""

import errno
import os
import socket

from fusion_core.model.errors import SettingsError

LAST_PORT = 65_535
# As many as viser tries itself.
_MAX_PORTS_TRIED = 1000


def free_port(host: str, port: int) -> int:
    """``port``, or the next free one after it; 0 stays 0 (any port).

    viser itself hangs if the address is unavailable or no port is free.

    Raises SettingsError if the address is not of this machine, no port is free, or the port is not
    permitted.
    """
    addresses = _addresses(host)
    if port == 0:
        _is_free(host, addresses, 0)
        return 0
    for tried in range(port, min(port + _MAX_PORTS_TRIED, LAST_PORT + 1)):
        if _is_free(host, addresses, tried):
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
        raise _address_error(host, error.strerror or str(error)) from error
    except ValueError as error:
        # Too long for a host name, or with invalid characters.
        raise _address_error(host, "it is no name of a machine") from error
    return [(family, str(address[0])) for family, _, _, _, address in found]


def _is_free(host: str, addresses: list[tuple[socket.AddressFamily, str]], port: int) -> bool:
    """Whether a port is free on all addresses. Raises SettingsError if it cannot be used at all."""
    for family, address in addresses:
        try:
            with socket.socket(family, socket.SOCK_STREAM) as probe:
                # As the server does: a port in TIME_WAIT counts as free.
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
            raise _address_error(host, error.strerror or str(error)) from error
    return True


def _address_error(host: str, reason: str) -> SettingsError:
    return SettingsError(
        f"--host {host[:80]}: cannot be listened on ({reason}).",
        advice="Name an address of this machine, such as 127.0.0.1.",
    )
