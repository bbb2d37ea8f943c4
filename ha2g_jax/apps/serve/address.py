"""The address at which the service listens."""

import contextlib
import ipaddress
import socket
from collections.abc import Iterator

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reason


@contextlib.contextmanager
def bound(host: str, port: int) -> Iterator[socket.socket]:
    """Yield a socket with an address, at which nothing listens yet.

    Args:
        host: name or address to listen at.
        port: port, 0 for a free one.

    Raises:
        UserError: the name is unknown or the address is taken.
    """
    family, address = resolve(host)[0]
    with socket.socket(family, socket.SOCK_STREAM) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((address, port))
        except OSError as error:
            raise UserError(
                f"cannot listen at {host}, port {port}: {reason(error).lower()}; give another --port"
            ) from error
        yield listener


def url(listener: socket.socket) -> str:
    """Return the address of a socket in the form of a browser."""
    host, port = listener.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def is_loopback(host: str) -> bool:
    """Return whether a host is this machine only.

    Args:
        host: name or address.

    Raises:
        UserError: the name is unknown.
    """
    return all(ipaddress.ip_address(address).is_loopback for _, address in resolve(host))


def resolve(host: str) -> list[tuple[int, str]]:
    """Return the families and addresses of a host.

    Args:
        host: name or address.

    Raises:
        UserError: the name is unknown.
    """
    try:
        found = socket.getaddrinfo(host or "0.0.0.0", None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise UserError(f"the host {host!r} is unknown; give a name or an address of this machine") from error
    return [(family, str(address[0]).partition("%")[0]) for family, _, _, _, address in found]
