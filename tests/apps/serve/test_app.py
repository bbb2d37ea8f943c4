"""The routes of the service and their description."""

import json

from ha2g_jax.apps.serve.messages import MotionQuery


def test_the_description_of_the_routes(client):
    routes = json.loads(client.ask("GET", "/openapi.json").body)["paths"]
    assert set(routes) == {"/health", "/metrics", "/v1/motion"}
    assert {parameter["name"] for parameter in routes["/v1/motion"]["post"]["parameters"]} == set(
        MotionQuery.model_fields
    )
