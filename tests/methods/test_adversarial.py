"""The discriminator has the layers of Table 8."""

import jax
import pytest

from ha2g_jax.methods.adversarial import Discriminator


@pytest.mark.torch
def test_equals_pytorch(oracles):
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    nn = torch.nn
    convs = [nn.Conv1d(6, 16, 3), nn.Conv1d(16, 8, 3), nn.Conv1d(8, 8, 3)]
    norms = [nn.BatchNorm1d(16), nn.BatchNorm1d(8)]
    gru = nn.GRU(8, 5, bidirectional=True, batch_first=True)
    linears = [nn.Linear(5, 1), nn.Linear(14, 1)]
    for norm in norms:
        oracles.shake(torch, norm)
    x = torch.randn(3, 20, 6)
    activate = nn.LeakyReLU(0.2)
    y = activate(norms[0].eval()(convs[0](x.transpose(1, 2))))
    y = convs[2](activate(norms[1].eval()(convs[1](y)))).transpose(1, 2)
    y, _ = gru(y)
    out = linears[1](linears[0](y[..., :5] + y[..., 5:])[..., 0])[..., 0]

    params = {f"conv_{index}": oracles.conv(layer) for index, layer in enumerate(convs, 1)}
    params |= {f"norm_{index}": oracles.norm(layer) for index, layer in enumerate(norms, 1)}
    params |= {f"linear_{index}": oracles.dense(layer) for index, layer in enumerate(linears, 1)}
    statistics = {f"norm_{index}": oracles.statistics(layer) for index, layer in enumerate(norms, 1)}
    variables = {"params": params | {"gru": oracles.gru(gru)}, "batch_stats": statistics}
    run = jax.jit(lambda poses: Discriminator(hidden_dim=5, layers=1).apply(variables, poses, train=False))
    oracles.assert_close(run(oracles.value(x)), oracles.value(out))
