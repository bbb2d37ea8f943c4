"""The route `POST /v1/motion`: sound in, a file of motion out."""

import asyncio
import pathlib
import shutil
import tempfile
import threading
import time
from collections.abc import Awaitable, Callable
from typing import Annotated, Any, BinaryIO

from fastapi import APIRouter, HTTPException, Query, Request, Response
from starlette.datastructures import UploadFile
from starlette.requests import ClientDisconnect

from ha2g_jax.apps.serve.guard import refusal
from ha2g_jax.apps.serve.messages import MotionQuery
from ha2g_jax.apps.serve.service import Full, Service, Stopped
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import read_audio
from ha2g_jax.files.reading import shown
from ha2g_jax.motion import formats
from ha2g_jax.synthesis import Audio

TYPES = {"npz": "application/zip", "json": "application/json", "csv": "text/csv", "bvh": "text/plain"}
_BINARY = "model/gltf-binary"  # glb and vrma
_RETRY_SECONDS = 5
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
_ERROR: dict[str, Any] = {
    "content": {"application/json": {"schema": {"type": "object", "properties": {"error": {"type": "string"}}}}}
}
_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {"description": "file of the motion", "content": {kind: {} for kind in (*TYPES.values(), _BINARY)}},
    400: {"description": "the body is not a form with one file", **_ERROR},
    408: {"description": "the upload took too long", **_ERROR},
    413: {"description": "the upload is too large", **_ERROR},
    422: {"description": "the sound or the query cannot be used", **_ERROR},
    429: {"description": "too many requests of this client, see Retry-After", **_ERROR},
    503: {"description": "too many requests are running, see Retry-After", **_ERROR},
}

# The decoder of MP3 is silenced by exchanging the standard error of the process, which one thread may do at a time.
_reading = threading.Lock()


def router(service: Service) -> APIRouter:
    """Return the route of a service.

    Args:
        service: model and limits.
    """
    routes = APIRouter()

    @routes.post("/v1/motion", response_class=Response, responses=_RESPONSES, openapi_extra=_FORM)
    async def motion(request: Request, query: Annotated[MotionQuery, Query()]) -> Response:
        """Generate motion for a file with sound."""
        try:
            with service.motions.take():
                return await service.run(_answer(service, request, query))
        except Stopped:
            return refusal(503, "the service has been stopped; try again later", service.settings.grace)
        except Full:
            return refusal(503, f"{service.settings.requests} requests are running; try again later", _RETRY_SECONDS)

    return routes


async def _answer(service: Service, request: Request, query: MotionQuery) -> Response:
    settings, options = service.settings, query.options()
    limited = Request(request.scope, _limited(request, settings.max_bytes))
    try:
        async with asyncio.timeout(settings.upload_seconds):
            form = await limited.form(max_files=1, max_fields=0)
    except TimeoutError:
        raise HTTPException(408, f"the upload took more than {settings.upload_seconds:g} s") from None
    except ClientDisconnect:
        raise HTTPException(400, "the client left during its upload") from None
    try:
        upload = form.get("speech")
        if not isinstance(upload, UploadFile):
            raise HTTPException(422, "the form has no file 'speech'; send one as multipart/form-data")
        name = shown(pathlib.PurePath(upload.filename or "speech").name or "speech")
        start = time.monotonic()
        content = await service.compute(lambda: _file(service, upload.file, name, query.format, options))
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


def _file(service: Service, sound: BinaryIO, name: str, suffix: str, options: Any) -> bytes:
    """Return the file of the motion for an uploaded file of sound."""
    with tempfile.TemporaryDirectory(dir=service.folder) as folder:
        path = pathlib.Path(folder) / "speech"
        with path.open("wb") as copy:
            shutil.copyfileobj(sound, copy)
        try:
            with _reading:
                samples = read_audio(path, max_seconds=service.settings.max_seconds)
        except UserError as error:
            raise UserError(str(error).replace(shown(path), name)) from None
        motion = service.model.generate(Audio(samples, name), **options)
        out = path.with_suffix(f".{suffix}")
        formats.export(motion, out)
        return out.read_bytes()
