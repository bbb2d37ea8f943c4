"""The pose auto-encoder has the layers of Table 9."""

import jax
import jax.numpy as jnp
import pytest

from ha2g_jax.methods.autoencoder import LATENT_DIMS, PoseAutoencoder
from ha2g_jax.skeleton import SKELETONS, load_skeleton

# Counts of the published auto-encoders; that of TED-Gesture has two more linear maps of 32 to 32.
PARAMETERS = {"ted_expressive": 226_214, "ted_gesture": 190_691 - 2 * (32 * 32 + 32)}


@pytest.mark.parametrize("name", SKELETONS)
def test_maps_a_window_to_its_latent_and_back(name):
    pose_dim = load_skeleton(name).pose_dim
    model = PoseAutoencoder(pose_dim, LATENT_DIMS[name])
    poses = jnp.zeros((2, 34, pose_dim))
    output, variables = jax.eval_shape(lambda key: model.init_with_output(key, poses, train=False), jax.random.key(0))
    assert output.shape == poses.shape
    latent = jax.eval_shape(lambda v: model.apply(v, poses, train=False, method=model.encode), variables)
    assert latent.shape == (2, LATENT_DIMS[name])
    assert sum(leaf.size for leaf in jax.tree.leaves(variables["params"])) == PARAMETERS[name]


@pytest.mark.torch
def test_equals_pytorch(oracles):
    torch = pytest.importorskip("torch")
    from fixtures.released_torch import PoseDecoder, PoseEncoder

    torch.manual_seed(0)
    encoder = PoseEncoder(9, 16, has_mean=False, slope=0.2).eval()
    decoder = PoseDecoder(9, 16, slope=0.2).eval()
    oracles.shake(torch, encoder)
    oracles.shake(torch, decoder)
    x = torch.randn(2, 34, 9)
    latent = encoder(x)
    out = decoder(latent)

    def tree(read, name, modules, start=1):
        return {f"{name}_{index}": read(module) for index, module in enumerate(modules, start)}

    def layers(module, *kinds):
        return [layer for layer in module.modules() if isinstance(layer, kinds)]

    nn = torch.nn
    variables = {
        "params": {
            "encoder": tree(oracles.conv, "conv", layers(encoder, nn.Conv1d))
            | tree(oracles.norm, "norm", layers(encoder, nn.BatchNorm1d))
            | tree(oracles.dense, "linear", layers(encoder, nn.Linear)),
            "decoder": tree(oracles.dense, "linear", layers(decoder, nn.Linear))
            | tree(oracles.norm, "norm", layers(decoder, nn.BatchNorm1d))
            | tree(oracles.transposed_conv, "conv", layers(decoder, nn.ConvTranspose1d))
            | tree(oracles.conv, "conv", layers(decoder, nn.Conv1d), start=3),
        },
        "batch_stats": {
            "encoder": tree(oracles.statistics, "norm", layers(encoder, nn.BatchNorm1d)),
            "decoder": tree(oracles.statistics, "norm", layers(decoder, nn.BatchNorm1d)),
        },
    }
    model = PoseAutoencoder(pose_dim=9, latent_dim=16)

    @jax.jit
    def run(poses):
        encode = model.apply(variables, poses, train=False, method=model.encode)
        return encode, model.apply(variables, poses, train=False)

    oracles.assert_close(run(oracles.value(x)), (oracles.value(latent), oracles.value(out)))
