"""What was saved comes back exactly, and what is damaged is named."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.train.checkpoint import Checkpoints, on_one_device
from ha2g_jax.train.state import Network, TrainState


def _state(value: float) -> TrainState:
    network = Network(params={"w": jnp.full((2, 3), value)}, batch_stats={}, opt_state=(jnp.int32(1),))
    return TrainState(step=jnp.int32(5), generator=network, discriminator=network)


@pytest.fixture
def checkpoints(tmp_path):
    checkpoints = Checkpoints(tmp_path / "latest", keep=2)
    for step in (1, 2, 3):
        checkpoints.save(step, _state(step / 3), {"iterator": {"next_index": step}})
    return checkpoints


def test_state_and_record_come_back(checkpoints):
    state, record = checkpoints.restore(3, on_one_device(_state(0.0)))
    assert record == checkpoints.record(3) == {"iterator": {"next_index": 3}}
    for found, expected in zip(jax.tree.leaves(state), jax.tree.leaves(_state(1.0)), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_the_last_ones_are_kept_and_none_is_written_twice(checkpoints):
    assert checkpoints.steps() == [2, 3]
    checkpoints.save(3, _state(9.0), {})
    assert checkpoints.record(3) == {"iterator": {"next_index": 3}}


def test_another_model_is_refused(checkpoints):
    other = _state(0.0).replace(generator=Network(params={"v": jnp.zeros(4)}, batch_stats={}, opt_state=()))
    with pytest.raises(UserError, match=r"latest/3 is damaged or of another model"):
        checkpoints.restore(3, on_one_device(other))


def test_a_damaged_one_is_named(checkpoints, tmp_path):
    for path in (tmp_path / "latest" / "3" / "state").rglob("*"):
        if path.is_file():
            path.write_bytes(b"")
    with pytest.raises(UserError, match=r"latest/3 is damaged"):
        checkpoints.restore(3, on_one_device(_state(0.0)))
