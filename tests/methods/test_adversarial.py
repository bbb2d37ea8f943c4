"""The discriminator has the layers of Table 8."""

import pytest

from ha2g_jax.methods.adversarial import Discriminator


@pytest.mark.torch
def test_equals_pytorch(oracles):
    torch = pytest.importorskip("torch")
    from fixtures import released_torch

    torch.manual_seed(0)
    theirs = released_torch.Discriminator(6, 5, 1, 0.2).eval()
    oracles.shake(torch, theirs)
    convs, norms = theirs.pre_conv[::3], theirs.pre_conv[1::3]

    def read(of):
        params = {f"conv_{index}": oracles.conv(layer, of) for index, layer in enumerate(convs, 1)}
        params |= {f"norm_{index}": oracles.norm(layer, of) for index, layer in enumerate(norms, 1)}
        params |= {"linear_1": oracles.dense(theirs.out, of), "linear_2": oracles.dense(theirs.out2, of)}
        return params | {"gru": oracles.gru(theirs.gru, of)}

    oracles.check(
        torch,
        Discriminator(hidden_dim=5, layers=1),
        read,
        theirs,
        torch.randn(3, 34, 6),
        lambda: {f"norm_{index}": oracles.statistics(layer) for index, layer in enumerate(norms, 1)},
        channels_first=False,
    )
