"""Fixtures of live runs."""

import dataclasses
import socket

import pytest
from apps.live.standins import FPS, FakeClock, FakeStream, poses

from ha2g_jax.apps.live.frames import Frame, Rigs
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.synthesis import Model


@pytest.fixture
def clock():
    return FakeClock()


@pytest.fixture(scope="session")
def skeleton():
    return load_skeleton("ted_expressive")


@pytest.fixture(scope="session")
def speaking_model(debug_model):
    """A model with styles and a name whose stream is a `FakeStream`."""

    class Speaking(Model):
        def stream(self, *, look_ahead=3, hop=1, **options):  # type: ignore[override]
            return FakeStream(self.assets.skeleton, look_ahead, hop)

    return Speaking(**{field.name: getattr(debug_model, field.name) for field in dataclasses.fields(Model)})


@pytest.fixture
def make_frames(skeleton):
    """A function from a number of frames and names of rigs to frames that are heard from time 100 on."""

    def make_frames(count, *names):
        rigs = Rigs(skeleton, FPS, names)
        directions = poses(skeleton, count)
        found = enumerate(zip(directions, rigs.convert(directions), strict=True))
        return [Frame(k, k / FPS, 100 + k / FPS, skeleton, pose, animations) for k, (pose, animations) in found]

    return make_frames


@pytest.fixture
def free_port():
    """A function that returns a port that nothing listens on."""

    def free_port(kind=socket.SOCK_STREAM):
        with socket.socket(socket.AF_INET, kind) as found:
            found.bind(("127.0.0.1", 0))
            return found.getsockname()[1]

    return free_port


@pytest.fixture
def receiver():
    """A UDP socket that is bound, and its port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bound:
        bound.bind(("127.0.0.1", 0))
        bound.settimeout(5)
        yield bound, bound.getsockname()[1]
