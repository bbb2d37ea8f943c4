"""Addresses of sources and sinks, such as vmc://127.0.0.1:39539, and the libraries of the extra `live`."""

import importlib
import socket
import urllib.parse
from types import ModuleType
from typing import NamedTuple

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown

_MAX_PORT = 65_535


class Address(NamedTuple):
    """A host and a port.

    Attributes:
        scheme: what is spoken there, such as "vmc".
        host: name or number of the host.
        port: 1 to 65535.
    """

    scheme: str
    host: str
    port: int

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"


def read_address(text: str, default_port: int | None = None) -> Address:
    """Parse an address.

    Args:
        text: SCHEME://HOST:PORT.
        default_port: port of an address without one; None if it must have one.

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

    A host with addresses of both kinds, such as localhost, is reached by IPv4, on which most receivers listen.

    Raises:
        UserError: the host is not known.
    """
    try:
        found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
        family, kind, protocol, _, target = min(found, key=lambda each: each[0] != socket.AF_INET)
        return socket.socket(family, kind, protocol), target
    except (OSError, UnicodeError) as error:
        raise UserError(f"no host {shown(address.host)} for {shown(str(address))}; check the name") from error


def import_extra(module: str, package: str) -> ModuleType:
    """Import a module of the extra `live`.

    Args:
        module: name of the module.
        package: name of its package, for the message.

    Raises:
        UserError: the package or a library that it needs is missing.
    """
    try:
        return importlib.import_module(module)
    except (ImportError, OSError) as error:  # sounddevice raises OSError without PortAudio
        why = "" if isinstance(error, ModuleNotFoundError) else f", which cannot be loaded ({error})"
        raise UserError(f"this needs {package}{why}: pip install 'ha2g-jax[live]'") from error
