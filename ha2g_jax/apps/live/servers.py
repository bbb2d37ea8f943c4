"""A WebSocket server in a thread of its own, which may have a page for browsers."""

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from typing import Any

from ha2g_jax.apps.live.addresses import Address, import_extra
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.viewer.live_page import LivePage

_CLOSE_SECONDS = 1.0  # for a client to answer that the connection is closed


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
    library = import_extra("websockets.sync.server", "websockets")
    closed = import_extra("websockets.exceptions", "websockets").ConnectionClosed
    logger = logging.getLogger(f"{__name__}.websockets")
    logger.propagate = False  # a client that speaks no WebSocket is no fault of this program

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
        raise UserError(
            f"cannot listen on {shown(str(address))} ({reason(error).lower()}); give another port or host"
        ) from error
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield
    finally:
        server.shutdown()
        thread.join()
