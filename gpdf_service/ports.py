"""Ports that are free, for a service that somebody begins and then asks."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
from pathlib import Path

LOOPBACK = "127.0.0.1"
EPHEMERAL = Path("/proc/sys/net/ipv4/ip_local_port_range")
"""Linux's ports for connections."""
REGISTERED = 49_152, 65_535
"""The same where a system does not tell its own (RFC 6335)."""
FIRST_PORT, LAST_PORT = 10_000, 65_535
"""Ports that no system service has of old."""
_given: dict[int, socket.socket | None] = {}
"""Ports that were given out, and what keeps other processes from them."""


def free_port() -> int:
    """A port on this machine that nobody listens on, and that nobody else who asks here is given while we live.

    It is none of those that the system gives to connections: one of them could take it before anybody listens there.
    Where sockets have no abstract names, another process may be given it, too.
    """
    low, high = map(int, EPHEMERAL.read_text().split()) if EPHEMERAL.exists() else REGISTERED
    ports = [port for port in range(FIRST_PORT, LAST_PORT + 1) if not low <= port <= high]
    begin = os.getpid() % len(ports)
    for port in ports[begin:] + ports[:begin]:
        with contextlib.suppress(OSError):  # somebody else has claimed it
            if port not in _given and not trouble_at(LOOPBACK, port):
                _given[port] = _claim(port) if EPHEMERAL.exists() else None
                return port
    raise OSError("every port of this machine is taken")


def trouble_at(host: str, port: int) -> str:
    """Why a program could not listen there now, in the system's words; empty if it could.

    Of a name's addresses one that this machine has not is passed over, as ::1 of localhost where IPv6 is off.

    Args:
        host: A name or an address, of IPv4 or IPv6, of this machine.
        port: Of TCP.
    """
    found, absent = False, ""
    try:
        for family, kind, _, _, address in socket.getaddrinfo(host, None, type=socket.SOCK_STREAM):
            try:
                _bind(family, kind, (address[0], port, *address[2:]))
                found = True
            except OSError as error:
                if error.errno not in (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT):
                    raise
                absent = error.strerror or str(error)
    except OSError as error:
        return error.strerror or str(error)
    except OverflowError as error:
        return str(error)
    return "" if found else absent


def _bind(family: int, kind: int, address: tuple[str | int, ...]) -> None:
    with socket.socket(family, kind) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # one that closed a moment ago may linger
        if family == socket.AF_INET6:
            probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        probe.bind(address)


def free_endpoint() -> str:
    """Where a service can listen: `free_port`."""
    return f"tcp/{LOOPBACK}:{free_port()}"


def _claim(port: int) -> socket.socket:
    """Keep other processes who ask here from it, by a name that ends with this one.

    Raises:
        OSError: somebody has it.
    """
    claim = socket.socket(socket.AF_UNIX)
    try:
        claim.bind(f"\0gpdf port {port}")  # Linux's abstract names are no files
    except OSError:
        claim.close()
        raise
    return claim
