"""A service with small limits."""

import pytest
from fixtures.service import running


@pytest.fixture(scope="module")
def client(debug_model):
    with running(debug_model, max_bytes=100_000, max_seconds=2.5, message_bytes=40_000, idle_seconds=5) as client:
        yield client
