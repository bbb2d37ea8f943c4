"""Motion over HTTP and WebSocket: `serve` runs the service of `ha2g serve`, see docs/serving.md."""

import pathlib

from ha2g_jax.apps.serve.settings import Settings
from ha2g_jax.errors import UserError

__all__ = ["Settings", "serve"]


def serve(checkpoint: str | pathlib.Path, settings: Settings) -> None:
    """Load a model and answer requests until SIGTERM or Ctrl-C.

    Args:
        checkpoint: model, see `synthesis.load`.
        settings: address, token and limits of the service.

    Raises:
        UserError: a library of the extra `serve` is missing, the settings or the model cannot be used, or the address
            is taken.
        KeyboardInterrupt: Ctrl-C, after the running requests.
    """
    try:
        import fastapi  # noqa: F401
        import prometheus_client  # noqa: F401
        import python_multipart  # noqa: F401
        import uvicorn  # noqa: F401
        import websockets  # noqa: F401
    except ModuleNotFoundError as error:
        raise UserError(f"ha2g serve needs {error.name}: pip install 'ha2g-jax[serve]'") from None
    if settings.workers > 1:
        from ha2g_jax.apps.serve import workers

        workers.run(checkpoint, settings)
    else:
        from ha2g_jax.apps.serve import server

        server.run(checkpoint, settings)
