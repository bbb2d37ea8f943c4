"""Motion over HTTP and WebSocket: `serve` runs the service of `ha2g serve`, see docs/serving.md."""

import pathlib

from ha2g_jax.apps.serve.settings import Settings, check
from ha2g_jax.errors import require

__all__ = ["Settings", "serve"]


def serve(checkpoint: str | pathlib.Path, settings: Settings) -> None:
    """Load a model, see `synthesis.load`, and answer requests until SIGTERM or Ctrl-C.

    Raises:
        UserError: a library of the extra `serve` is missing, the settings or the model cannot be used, or the address
            is taken.
        KeyboardInterrupt: Ctrl-C, after the running requests.
    """
    for module in ("fastapi", "prometheus_client", "python_multipart", "uvicorn", "websockets"):
        require(module, "serve", by="ha2g serve")
    check(settings)
    if settings.workers > 1:
        from ha2g_jax.apps.serve import workers

        workers.run(checkpoint, settings)
    else:
        from ha2g_jax.apps.serve import server

        server.run(checkpoint, settings)
