"""Who may use the service, and how often."""

import pytest
from fixtures.service import TOKEN, begin, running, wav
from websockets.exceptions import InvalidStatus

from ha2g_jax.apps.serve.guard import Rates


def test_every_route_but_health_needs_the_token(debug_model):
    with running(debug_model, token=TOKEN) as client:
        assert client.ask("GET", "/health").status == 200
        right, wrong = {"Authorization": f"Bearer {TOKEN}"}, {"Authorization": f"Bearer {TOKEN}x"}
        for path in ("/metrics", "/openapi.json", "/none"):
            assert client.ask("GET", path).status == 401 and client.ask("GET", path, None, wrong).status == 401
        assert client.ask("GET", "/metrics", None, right).status == 200
        assert client.ask("GET", f"/metrics?token={TOKEN}").status == 401
        assert client.post("", wav(0.3)).status == 401 and client.post("", wav(0.3), **right).status == 200
        for query in ("", "?token=x"):
            with pytest.raises(InvalidStatus) as refused, client.stream(query):
                pass
            assert refused.value.response.status_code == 401
        for query, headers in ((f"?token={TOKEN}", {}), ("", right)):
            with client.stream(query, additional_headers=headers) as websocket:
                assert begin(websocket)["fps"] == 15


def test_pages_of_other_hosts_are_refused(debug_model):
    with running(debug_model, origins=("https://good.example",)) as client:
        with pytest.raises(InvalidStatus) as refused, client.stream(origin="https://evil.example"):
            pass
        assert refused.value.response.status_code == 403
        for origin in ("https://good.example", f"http://127.0.0.1:{client.port}"):
            with client.stream(origin=origin) as websocket:
                assert begin(websocket)["fps"] == 15
        assert client.post("", wav(0.3), Origin="null").status == 403
        for path in ("/", "/metrics"):
            assert client.ask("GET", path, None, {"Host": "evil.example"}).status == 403
            assert client.ask("GET", path, None, {"Origin": "https://evil.example"}).status == 403


def test_each_address_has_its_rate():
    now = 0.0
    rates = Rates(60, lambda: now)
    assert [rates.wait("a") for _ in range(61)] == [0.0] * 60 + [1.0] and rates.wait("b") == 0
    now = 1.0
    assert rates.wait("a") == 0 and rates.wait("a") == 1


def test_too_many_requests_are_told_when_to_come_back(debug_model):
    with running(debug_model, rate=1) as client:
        assert client.ask("GET", "/metrics").status == 200
        answer = client.ask("GET", "/metrics")
        assert answer.status == 429 and 50 < int(answer.headers["Retry-After"]) <= 60
        assert client.ask("GET", "/health").status == 200
