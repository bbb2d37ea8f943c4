"""Address, token and limits of the service."""

import contextlib
import dataclasses
import ipaddress
import math
import socket
import urllib.parse
from collections.abc import Iterator

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reason

_MIN_TOKEN = 16  # characters


@dataclasses.dataclass(frozen=True)
class Settings:
    """Settings of `ha2g serve`; an address that other machines can reach needs a token.

    Attributes:
        host: name or address to listen at.
        port: port to listen at, 0 for a free one.
        token: secret that requests must have, at least 16 characters; None for none.
        origins: origins of web pages of other hosts that may use the service, such as "https://example.org".
        workers: number of processes, each with its own model; the limits below apply to each of them.
        sessions: maximum number of streams at a time.
        requests: maximum number of requests for motion at a time.
        rate: requests a minute from one address of a client, 0 for any number.
        max_bytes: maximum size of the body of a request, in bytes.
        max_seconds: maximum length of the sound of a request, in seconds.
        upload_seconds: seconds that the body of a request may take to arrive.
        message_bytes: maximum size of a message of a stream, in bytes.
        session_seconds: seconds that a stream may last.
        idle_seconds: seconds that a client of a stream may neither send nor receive.
        grace: seconds that running requests may go on after SIGTERM.
    """

    host: str = "127.0.0.1"
    port: int = 8000
    token: str | None = None
    origins: tuple[str, ...] = ()
    workers: int = 1
    sessions: int = 6
    requests: int = 2
    rate: float = 120
    max_bytes: int = 64 << 20
    max_seconds: float = 600
    upload_seconds: float = 60
    message_bytes: int = 256 << 10
    session_seconds: float = 3600
    idle_seconds: float = 30
    grace: float = 30


def check(settings: Settings) -> None:
    """Check that numbers are in range, and that there is a token if other machines can reach the host.

    Raises:
        UserError: a setting is not valid, or the host is not a loopback address and there is no token.
    """
    if not 0 <= settings.port <= 65535:
        raise UserError(f"the port is {settings.port}; expected 0 to 65535")
    for name in ("rate", "grace", "max_seconds", "session_seconds", "idle_seconds"):
        value, may_be_zero = getattr(settings, name), name in ("rate", "grace")
        if not math.isfinite(value) or value < 0 or (value == 0 and not may_be_zero):
            expected = "of at least 0" if may_be_zero else "above 0"
            raise UserError(f"--{name.replace('_', '-')} is {value}; expected a number {expected}")
    for origin in settings.origins:
        if not _is_origin(origin):
            raise UserError(f"--origin {origin!r} is not as browsers send it; give it in the form https://example.org")
    token = settings.token
    if token is not None and not (len(token) >= _MIN_TOKEN and token.isascii() and token.isprintable()):
        raise UserError(f"the token is too short, or not ASCII; give {_MIN_TOKEN} or more random characters")
    if token is not None and token != token.strip():  # HTTP removes them from what a client sends
        raise UserError("the token begins or ends with a space; leave it out")
    if token is None and not is_loopback(settings.host):
        raise UserError(f"other machines reach {settings.host}: give --token, or HA2G_TOKEN in the environment")


def _is_origin(text: str) -> bool:
    """Return whether a text is the origin of a page: lower case, without a path and without the usual port."""
    try:
        parts = urllib.parse.urlsplit(text)
        is_usual = parts.port == {"http": 80, "https": 443}.get(parts.scheme, 0)
    except ValueError:
        return False
    return bool(parts.hostname) and not is_usual and text == f"{parts.scheme}://{parts.netloc}".lower()


@contextlib.contextmanager
def bound(host: str, port: int) -> Iterator[socket.socket]:
    """Yield a socket bound to an address, at which nothing listens yet; port 0 is a free one.

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
    """Return whether a host, given by name or address, is this machine only."""
    return all(ipaddress.ip_address(address).is_loopback for _, address in resolve(host))


def resolve(host: str) -> list[tuple[int, str]]:
    """Return the families and addresses of a host.

    Raises:
        UserError: the name is unknown.
    """
    try:
        found = socket.getaddrinfo(host or "0.0.0.0", None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise UserError(f"the host {host!r} is unknown; give a name or an address of this machine") from error
    return [(family, str(address[0]).partition("%")[0]) for family, _, _, _, address in found]
