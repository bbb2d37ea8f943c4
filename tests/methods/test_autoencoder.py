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
    torch.manual_seed(0)
    nn = torch.nn
    activation = nn.LeakyReLU(0.2)
    convs = [nn.Conv1d(9, 32, 3), nn.Conv1d(32, 64, 3), nn.Conv1d(64, 64, 4, 2), nn.Conv1d(64, 32, 3)]
    linears = [nn.Linear(384, 256), nn.Linear(256, 128), nn.Linear(128, 16)]
    norms = [nn.BatchNorm1d(size) for size in (32, 64, 64, 256, 128)]
    encoder = nn.Sequential(
        *(convs[0], norms[0], activation, convs[1], norms[1], activation, convs[2], norms[2], activation, convs[3]),
        *(nn.Flatten(), linears[0], norms[3], activation, linears[1], norms[4], activation, linears[2]),
    ).eval()
    decoder_linears = [nn.Linear(16, 64), nn.Linear(64, 136)]
    transposed = [nn.ConvTranspose1d(4, 32, 3), nn.ConvTranspose1d(32, 32, 3)]
    decoder_convs = [nn.Conv1d(32, 32, 3), nn.Conv1d(32, 9, 3)]
    decoder_norms = [nn.BatchNorm1d(size) for size in (64, 32, 32)]
    decoder = nn.Sequential(
        *(decoder_linears[0], decoder_norms[0], activation, decoder_linears[1], nn.Unflatten(1, (4, 34))),
        *(transposed[0], decoder_norms[1], activation, transposed[1], decoder_norms[2], activation),
        *decoder_convs,
    ).eval()
    oracles.shake(torch, encoder)
    oracles.shake(torch, decoder)
    x = torch.randn(2, 34, 9)
    latent = encoder(x.transpose(1, 2))
    out = decoder(latent).transpose(1, 2)

    def tree(read, name, layers, start=1):
        return {f"{name}_{index}": read(layer) for index, layer in enumerate(layers, start)}

    variables = {
        "params": {
            "encoder": tree(oracles.conv, "conv", convs)
            | tree(oracles.norm, "norm", norms)
            | tree(oracles.dense, "linear", linears),
            "decoder": tree(oracles.dense, "linear", decoder_linears)
            | tree(oracles.norm, "norm", decoder_norms)
            | tree(oracles.transposed_conv, "conv", transposed)
            | tree(oracles.conv, "conv", decoder_convs, start=3),
        },
        "batch_stats": {
            "encoder": tree(oracles.statistics, "norm", norms),
            "decoder": tree(oracles.statistics, "norm", decoder_norms),
        },
    }
    model = PoseAutoencoder(pose_dim=9, latent_dim=16)

    @jax.jit
    def run(poses):
        encode = model.apply(variables, poses, train=False, method=model.encode)
        return encode, model.apply(variables, poses, train=False)

    oracles.assert_close(run(oracles.value(x)), (oracles.value(latent), oracles.value(out)))
