"""The skeletons."""

import pytest

from ha2g_jax.skeleton import SKELETONS, Skeleton, load_skeleton


@pytest.fixture(params=SKELETONS)
def skeleton(request: pytest.FixtureRequest) -> Skeleton:
    return load_skeleton(request.param)
