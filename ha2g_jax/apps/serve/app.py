"""The application: routes, and errors as one line of JSON."""

import logging

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from prometheus_client import CONTENT_TYPE_LATEST
from starlette.exceptions import HTTPException

from ha2g_jax import __version__
from ha2g_jax.apps.serve import motions, page, streams
from ha2g_jax.apps.serve.guard import Guard, refusal
from ha2g_jax.apps.serve.messages import one_line
from ha2g_jax.apps.serve.service import Service
from ha2g_jax.errors import UserError

_logger = logging.getLogger(__name__)


def create_app(service: Service) -> FastAPI:
    """Return the application of a service, for any server of ASGI.

    Args:
        service: model and limits.
    """
    # The pages of FastAPI load scripts from the network, so that only the description itself is served.
    app = FastAPI(title="ha2g", version=__version__, docs_url=None, redoc_url=None)

    @app.get("/health", responses={503: {"description": "the service is being stopped"}})
    async def health() -> JSONResponse:
        """Tell whether the service takes requests."""
        state = "stopping" if service.is_stopping else "ready"
        facts = {"version": __version__, "model": service.model.config.name, "checkpoint": service.model.assets.hash}
        return JSONResponse({"status": state} | facts, 503 if service.is_stopping else 200)

    @app.get("/metrics", response_class=Response)
    async def metrics() -> Response:
        """Return the counters in the text form of Prometheus."""
        return Response(service.counters.text(), media_type=CONTENT_TYPE_LATEST)

    app.include_router(page.router(service))
    app.include_router(motions.router(service))
    app.include_router(streams.router(service))
    app.exception_handler(UserError)(_user_error)
    app.exception_handler(RequestValidationError)(_bad_query)
    app.exception_handler(HTTPException)(_http_error)
    app.exception_handler(Exception)(_fault)
    app.add_middleware(Guard, service=service)
    return app


async def _user_error(_: Request, error: UserError) -> JSONResponse:
    return refusal(422, str(error))


async def _bad_query(_: Request, error: RequestValidationError) -> JSONResponse:
    return refusal(422, one_line(list(error.errors())))


async def _http_error(_: Request, error: HTTPException) -> JSONResponse:
    answer = refusal(error.status_code, str(error.detail))
    answer.headers.update(error.headers or {})
    return answer


async def _fault(_: Request, error: Exception) -> JSONResponse:
    del error  # the server logs it
    return refusal(500, "a fault of the service; its log has the reason")
