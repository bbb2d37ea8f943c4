"""The application: its routes of HTTP, and errors as one line of JSON."""

import asyncio
import errno
import logging
import pathlib
import shutil
import tempfile
import time
from collections.abc import Awaitable, Callable
from typing import Annotated, Any, BinaryIO

from fastapi import FastAPI, Query, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from prometheus_client import CONTENT_TYPE_LATEST
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException
from starlette.formparsers import MultiPartException
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import ClientDisconnect

from ha2g_jax import __version__
from ha2g_jax.apps.serve import streams
from ha2g_jax.apps.serve.guard import Guard, refusal
from ha2g_jax.apps.serve.messages import MotionQuery, one_line
from ha2g_jax.apps.serve.service import Full, Service, Stopped
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import read_audio
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.motion import formats
from ha2g_jax.synthesis import Audio
from ha2g_jax.viewer.page import live_page

TYPES = {"npz": "application/zip", "json": "application/json", "csv": "text/csv", "bvh": "text/plain"}
_BINARY = "model/gltf-binary"  # glb and vrma
_RETRY_SECONDS = 5
_UNKNOWN = {404: "no such address; /openapi.json has all", 405: "another method is expected; /openapi.json says which"}
_NO_FORM = "the body is not a form with one file 'speech'; send multipart/form-data, as curl -F speech=@speech.wav does"
_FULL_DISK = (errno.ENOSPC, errno.EDQUOT)
_FORM: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["speech"],
                    "properties": {"speech": {"type": "string", "format": "binary", "description": "file with sound"}},
                }
            }
        },
    }
}
_ERROR = {"schema": {"type": "object", "properties": {"error": {"type": "string"}}}}
_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {"description": "file of the motion", "content": {kind: {} for kind in (*TYPES.values(), _BINARY)}},
    "default": {"description": "the reason as one line, see docs/serving.md", "content": {"application/json": _ERROR}},
}

_logger = logging.getLogger(__name__)


def create_app(service: Service) -> FastAPI:
    """Return the application of a service, for a server of ASGI that runs it with lifespan off."""
    # The pages of FastAPI load scripts from the network, so that only the description itself is served.
    app = FastAPI(title="ha2g", version=__version__, docs_url=None, redoc_url=None)

    @app.head("/health", include_in_schema=False)
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

    _add_page(app, service)
    _add_motion(app, service)
    app.include_router(streams.router(service))
    app.exception_handler(UserError)(_user_error)
    app.exception_handler(OSError)(_system_error)
    app.exception_handler(RequestValidationError)(_bad_query)
    app.exception_handler(HTTPException)(_http_error)
    app.exception_handler(Exception)(_server_error)
    app.add_middleware(Guard, service=service)
    if origins := service.settings.origins:  # outside of the guard, as a browser asks without a token
        app.add_middleware(
            CORSMiddleware,
            allow_origins=origins,
            allow_methods=["GET", "POST"],
            allow_headers=["Authorization"],
            expose_headers=["Retry-After"],
        )
    return app


async def _user_error(request: Request, error: UserError) -> JSONResponse:
    if isinstance(error.__cause__, OSError):  # the file of the motion cannot be written
        return await _system_error(request, error.__cause__)
    return refusal(422, str(error))


async def _system_error(_: Request, error: OSError) -> JSONResponse:
    """Answer that the disk is full or the folder of temporary files is gone, and log it as one line."""
    _logger.error("no file can be written: %s", reason(error).lower())
    if error.errno in _FULL_DISK:
        return refusal(507, "the disk of the service is full; try again later", _RETRY_SECONDS)
    return refusal(503, "the service cannot write temporary files; its log has the reason", _RETRY_SECONDS)


async def _bad_query(_: Request, error: RequestValidationError) -> JSONResponse:
    return refusal(422, one_line(list(error.errors())))


async def _http_error(_: Request, error: HTTPException) -> JSONResponse:
    answer = refusal(error.status_code, _UNKNOWN.get(error.status_code, str(error.detail)))
    answer.headers.update(error.headers or {})
    return answer


async def _server_error(_: Request, error: Exception) -> JSONResponse:
    del error  # the server logs it
    return refusal(500, "an error of the service; its log has the reason")


def _add_page(app: FastAPI, service: Service) -> None:
    """Add a page that sends the sound of a file or the microphone to `/v1/stream` and shows the frames.

    The page needs no token, as a browser sends none with an address; so it names no speakers where there is one.
    """
    spec, assets, needs_token = service.model.spec, service.model.assets, service.settings.token is not None
    speakers = () if needs_token else tuple(assets.speakers)
    shown = live_page("sound", assets.skeleton, spec.fps, speakers=speakers, needs_token=needs_token)

    @app.get("/", include_in_schema=False)
    async def page() -> Response:
        return Response(shown.content, headers=shown.headers)


def _add_motion(app: FastAPI, service: Service) -> None:
    """Add `POST /v1/motion`: sound in, a file of motion out."""

    @app.post("/v1/motion", response_class=Response, responses=_RESPONSES, openapi_extra=_FORM)
    async def motion(request: Request, query: Annotated[MotionQuery, Query()]) -> Response:
        """Generate motion for a file with sound."""
        try:
            with service.motions.take():
                return await service.run(_answer(service, request, query))
        except Stopped:
            return refusal(503, "the service has been stopped; try again later", service.settings.grace)
        except Full:
            return refusal(503, f"{service.settings.requests} requests are running; try again later", _RETRY_SECONDS)


async def _answer(service: Service, request: Request, query: MotionQuery) -> Response:
    settings, options = service.settings, query.options()
    # Without the application in it, the message of a parser is an exception of its own.
    scope = {name: value for name, value in request.scope.items() if name != "app"}
    limited = Request(scope, _limited(request, settings.max_bytes))
    try:
        async with asyncio.timeout(settings.upload_seconds):
            form = await limited.form(max_files=1, max_fields=0)
    except TimeoutError:
        raise HTTPException(408, f"the upload took more than {settings.upload_seconds:g} s") from None
    except MultiPartException:
        raise HTTPException(400, _NO_FORM) from None
    except ClientDisconnect:
        raise HTTPException(400, "the client left during its upload") from None
    try:
        upload = form.get("speech")
        if not isinstance(upload, UploadFile):
            raise HTTPException(400, _NO_FORM)
        name = shown(pathlib.PurePath(upload.filename or "speech").name or "speech")
        start = time.monotonic()
        content = await service.compute(_file, service, upload.file, name, query, options)
        service.counters.motion_seconds.observe(time.monotonic() - start)
    finally:
        await form.close()
    return Response(content, media_type=TYPES.get(query.format, _BINARY))


def _limited(request: Request, max_bytes: int) -> Callable[[], Awaitable[Any]]:
    """Return the function that receives the body of a request, up to a number of bytes."""
    error = HTTPException(413, f"the upload has more than {max_bytes} bytes; send less, such as MP3 or mono at 16 kHz")
    declared = request.headers.get("content-length", "0")
    if not declared.isascii() or not declared.isdecimal() or int(declared[:20]) > max_bytes:
        raise error
    received = 0

    async def receive() -> Any:
        nonlocal received
        message = await request.receive()
        received += len(message.get("body", b""))
        if received > max_bytes:
            raise error
        return message

    return receive


def _file(service: Service, sound: BinaryIO, name: str, query: MotionQuery, options: Any) -> bytes:
    """Return the file of the motion for an uploaded file of sound."""
    with tempfile.TemporaryDirectory(dir=service.folder) as folder:
        path = pathlib.Path(folder) / "speech"
        with path.open("wb") as copy:
            shutil.copyfileobj(sound, copy)
        samples = read_audio(path, service.settings.max_seconds, name=name)
        motion = service.model.generate(Audio(samples, name), **options)
        out = path.with_suffix(f".{query.format}")
        formats.export(motion, out, rig=query.rig)
        return out.read_bytes()
