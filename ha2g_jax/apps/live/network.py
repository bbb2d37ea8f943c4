"""Addresses such as vmc://127.0.0.1:39539, sockets for them, and a WebSocket server."""

import contextlib
import logging
import socket
import threading
import urllib.parse
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from ha2g_jax.errors import UserError, require
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.viewer.page import LivePage

_MAX_PORT = 65_535
_CLOSE_SECONDS = 1.0  # for a client to answer that the connection is closed


class Address(NamedTuple):
    """Host and port, and the protocol there, such as "vmc"."""

    scheme: str
    host: str
    port: int

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"


def read_address(text: str, default_port: int | None = None) -> Address:
    """Parse SCHEME://HOST:PORT, or SCHEME://HOST where there is a default port.

    Raises:
        UserError: the address has no host, no port or another form, or the port is out of range.
    """
    try:
        parts = urllib.parse.urlsplit(text)
        host = parts.hostname
    except ValueError:  # such as half of the brackets of an IPv6 address
        raise UserError(f"cannot read the address {shown(text)}; give SCHEME://HOST:PORT") from None
    try:
        port = default_port if parts.port is None else parts.port
    except ValueError:
        port = 0
    if port is not None and not 1 <= port <= _MAX_PORT:
        raise UserError(f"the port of {shown(text)} is out of range; give one from 1 to {_MAX_PORT}")
    if not host or port is None or parts.path.strip("/") or parts.query or parts.fragment or parts.username:
        raise UserError(f"cannot read the address {shown(text)}; give {parts.scheme}://HOST:PORT")
    return Address(parts.scheme, host, port)


def udp_target(address: Address) -> tuple[socket.socket, tuple]:
    """Return a socket for datagrams to an address, and the address as the socket takes it.

    A host with IPv4 and IPv6 addresses, such as localhost, is reached by IPv4, on which most receivers listen.

    Raises:
        UserError: the host is not known.
    """
    try:
        found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
        family, kind, protocol, _, target = min(found, key=lambda each: each[0] != socket.AF_INET)
        made = socket.socket(family, kind, protocol)
    except (OSError, UnicodeError) as error:
        raise UserError(f"no host {shown(address.host)} for {shown(str(address))}; check the name") from error
    made.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    return made, target


@contextlib.contextmanager
def serving(address: Address, handle: Callable[[Any], None], page: LivePage | None = None) -> Iterator[None]:
    """Serve WebSockets in a thread while the context lasts.

    Args:
        address: where to listen.
        handle: called with each connection in a thread of its own; it must return when the context ends or the
            connection is closed, and the connection is closed when it returns.
        page: page that browsers get at the same address.

    Raises:
        UserError: the address is in use or not one of this computer, or the library is missing.
    """
    library = require("websockets.sync.server", "live")
    closed = require("websockets.exceptions", "live").ConnectionClosed
    logger = logging.getLogger(f"{__name__}.websockets")
    # A client that does not speak WebSocket, or leaves, is not an error of this program.
    logger.propagate, logger.handlers[:] = False, [logging.NullHandler()]

    def guarded(connection: Any) -> None:
        with contextlib.suppress(closed):
            handle(connection)

    def answer(connection: Any, request: Any) -> Any:
        if page is None or "Upgrade" in request.headers:
            return None
        if request.path != "/":
            return connection.respond(404, "there is one page, at /\n")
        answer = connection.respond(200, page.content.decode())
        del answer.headers["Content-Type"]
        answer.headers.update(page.headers)
        return answer

    try:
        server = library.serve(
            guarded,
            address.host,
            address.port,
            process_request=answer,
            logger=logger,
            compression=None,
            close_timeout=_CLOSE_SECONDS,
        )
    except OSError as error:
        why = reason(error).partition(" (while")[0].lower()
        raise UserError(f"cannot listen on {shown(str(address))} ({why}); give another port or host") from error
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield
    finally:
        server.shutdown()
        thread.join()
