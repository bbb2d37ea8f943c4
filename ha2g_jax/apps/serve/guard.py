"""Checks that every request must pass first: the rate of its client, its host, its origin and its token."""

import hmac
import ipaddress
import math
import time
import urllib.parse
from collections import OrderedDict
from collections.abc import Callable

from starlette.datastructures import Headers, QueryParams
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ha2g_jax.apps.serve.service import Service
from ha2g_jax.apps.serve.settings import Settings

OPEN = "/health"  # the route that needs nothing
PAGE = "/"  # the route that needs no token; the page asks for it
ROUTES = (OPEN, PAGE, "/metrics", "/openapi.json", "/v1/motion", "/v1/stream")
_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_MAX_CLIENTS = 10_000  # addresses that are remembered


def refusal(status: int, text: str, retry_after: float | None = None) -> JSONResponse:
    """Return the answer to a request that is refused, with the reason as one line.

    Args:
        retry_after: seconds after which the client may try again.
    """
    headers = {} if retry_after is None else {"Retry-After": str(math.ceil(retry_after))}
    if status == 401:
        headers["WWW-Authenticate"] = "Bearer"
    return JSONResponse({"error": text}, status, headers)


class Guard:
    """Middleware that refuses a request, or a stream before it is accepted, and counts all answers."""

    def __init__(self, app: ASGIApp, service: Service):
        self._app, self._service = app, service
        self._rates = Rates(service.settings.rate)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        answer = self._refusal(scope) or self._app
        await answer(scope, receive, self._counting(scope["path"], send))

    def _refusal(self, scope: Scope) -> JSONResponse | None:
        settings, headers = self._service.settings, Headers(scope=scope)
        host, origin = headers.get("host", ""), headers.get("origin")
        if not _is_known(host, settings):
            return refusal(
                421, "the service does not answer to this host; name it with --host, or --origin http://HOST"
            )
        if scope["path"] == OPEN:
            return None
        wait = self._rates.wait(scope["client"][0] if scope.get("client") else "")
        if wait:
            return refusal(429, f"more than {settings.rate:g} requests a minute; try again later", wait)
        if origin is not None and not _is_allowed(origin, host, settings):
            return refusal(403, "a page of this origin may not use the service; allow it with --origin")
        token = None if scope["path"] == PAGE else settings.token
        if token is not None and not _has_token(scope, headers, token):
            return refusal(401, "the token is missing or wrong; send 'Authorization: Bearer TOKEN'")
        if self._service.is_stopping:
            return refusal(503, "the service is being stopped", settings.grace)
        return None

    def _counting(self, path: str, send: Send) -> Send:
        route = path if path in ROUTES else "other"

        async def counting(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start", "websocket.accept"):
                self._service.counters.requests.labels(route, message.get("status", 101)).inc()
            await send(message)

        return counting


class Rates:
    """Rate limit of each address: the requests of a minute at once, then as many as the rate allows.

    Args:
        rate: requests a minute, 0 for any number.
        clock: function that returns the time in seconds.
    """

    def __init__(self, rate: float, clock: Callable[[], float] = time.monotonic):
        self._rate, self._clock = rate, clock
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()  # address -> requests left, at a time

    def wait(self, address: str) -> float:
        """Count a request of an address, and return 0, or the seconds after which the next one is allowed."""
        if not self._rate:
            return 0.0
        now = self._clock()
        most = max(self._rate, 1.0)
        left, before = self._left.pop(address, (most, now))
        left = min(left + (now - before) * self._rate / 60, most)
        wait = 0.0 if left >= 1 else (1 - left) * 60 / self._rate
        self._left[address] = (left if wait else left - 1, now)
        if len(self._left) > _MAX_CLIENTS:
            self._left.popitem(last=False)
        return wait


def _has_token(scope: Scope, headers: Headers, token: str) -> bool:
    """Return whether a request has the token: in a header, or in the query of a stream, as browsers send no header."""
    kind, _, given = headers.get("authorization", "").partition(" ")
    if kind.lower() != "bearer":
        given = QueryParams(scope["query_string"]).get("token", "") if scope["type"] == "websocket" else ""
    return hmac.compare_digest(given.strip().encode(), token.encode())


def _is_allowed(origin: str, host: str, settings: Settings) -> bool:
    """Return whether a page of an origin may send requests: one of the same host, or of those of the settings."""
    return origin in settings.origins or (bool(host) and origin in (f"http://{host}", f"https://{host}"))


def _is_known(host: str, settings: Settings) -> bool:
    """Return whether the host of a request is loopback, or one that the user has named.

    The page of another site may have pointed the name of its own host at this machine (DNS rebinding). It cannot do so
    with an address, nor leave out the host, as health probes do. Without a token such requests are refused all the
    same.
    """
    name = _name(f"//{host}")
    if name in (*_LOOPBACK, settings.host.lower(), *map(_name, settings.origins)) and name:
        return True
    return settings.token is not None and (not host or _is_address(name))


def _is_address(name: str) -> bool:
    try:
        return bool(ipaddress.ip_address(name))
    except ValueError:
        return False


def _name(url: str) -> str:
    try:
        return urllib.parse.urlsplit(url).hostname or ""
    except ValueError:
        return ""
