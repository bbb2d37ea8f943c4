"""The route `GET /`: a page that sends the sound of a file or the microphone to `/v1/stream` and shows the frames."""

from fastapi import APIRouter, Response

from ha2g_jax.apps.serve.service import Service
from ha2g_jax.viewer.live_page import live_page


def router(service: Service) -> APIRouter:
    """Return the route of a service.

    The page needs no token, as a browser sends none with an address; so it names no speakers where there is one.

    Args:
        service: model and settings.
    """
    spec, assets, needs_token = service.model.spec, service.model.assets, service.settings.token is not None
    speakers = () if needs_token else tuple(assets.speakers)
    shown = live_page("sound", assets.skeleton, spec.fps, speakers=speakers, needs_token=needs_token)
    routes = APIRouter()

    @routes.get("/", include_in_schema=False)
    async def page() -> Response:
        """Return the page."""
        return Response(shown.content, headers=shown.headers)

    return routes
