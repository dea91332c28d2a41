"""Where a page is served: by default where only this machine sees it."""

from __future__ import annotations

import errno
import socket

from kr210_sim.exceptions import BadInput

HOST, PORT = "127.0.0.1", 8080

VIEWERS = ("web", "native")
"""A page in a browser, or MuJoCo's own window."""


def check_address(host: str, port: int) -> None:
    """Make sure that a place can be listened on.

    Raises:
        BadInput: naming the option and the remedy.
    """
    if not 1 <= port <= 65535:
        raise BadInput(f"--port: {port} is no port; give 1 to 65535")
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError) as error:
        raise BadInput(f"--host: '{host}' is no address of this machine") from error
    with socket.socket(family, kind) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(address)
        except PermissionError as error:
            raise BadInput(f"--port: {port} is reserved; give one above 1023") from error
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise in_use(host, port) from error
            raise BadInput(f"--host: '{host}' is no address of this machine") from error


def in_use(host: str, port: int) -> BadInput:
    """Return the error that says that another program listens there."""
    return BadInput(f"--port: {port} on {host} is in use; give another one")


def is_loopback(host: str) -> bool:
    """Tell whether only this machine reaches an address."""
    return host == "localhost" or host == "::1" or host.startswith("127.")
