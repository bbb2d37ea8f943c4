"""Released files that PyTorch has written give its outputs in our modules, and each tensor is used exactly once."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint.released.importing import import_weights, read_released
from ha2g_jax.config import presets
from ha2g_jax.files.torch_archive import read_torch
from ha2g_jax.methods import generating_method_of
from ha2g_jax.skeleton import load_skeleton

pytestmark = [pytest.mark.torch, pytest.mark.filterwarnings("ignore:.*weight_norm.*:FutureWarning")]

WORDS, SPEAKERS = ["the", "Hand", "rises"], ["video-a", "video-b"]
WIDTHS = {"ted_expressive": 126, "ted_gesture": 27}


@pytest.fixture(scope="module")
def nets():
    torch = pytest.importorskip("torch")
    from fixtures import released_torch

    torch.manual_seed(0)
    return released_torch


def _mean(data):
    return 1.5 * load_skeleton(data).mean_directions.ravel()  # not that of the skeleton, so that its use shows


def _settings(config):
    part = config.model
    return (7, 3, part.inferer.hidden_dim, part.inferer.layers, part.text.channels, part.text.layers)


def _discriminator(nets, data, config, slope):
    part = config.model.discriminator
    return nets.Discriminator(WIDTHS[data], part.hidden_dim, part.layers, slope)


def _shaken(nets, oracles, *modules):
    for module in modules:
        oracles.shake(nets.torch, module.eval())
    return modules


def _compare_discriminator(nets, found, theirs, tolerance=1e-5):
    poses = nets.torch.randn(2, 34, found.spec.skeleton.pose_dim)
    ours = found.spec.discriminator.apply(found.discriminator, poses.numpy(), train=False)
    np.testing.assert_allclose(ours, theirs(poses).detach(), atol=tolerance)


def _check_each_tensor_is_used_once(content, found):
    """Each number of the file that has a row is in the variables exactly once."""
    rows = [row for row in found.rows if row.part in content]
    assert len({(row.part, row.name) for row in rows}) == len(rows) == len({row.target for row in rows})
    rest = {name for part in {row.part for row in rows} for name in content[part]} - {row.name for row in rows}
    assert all(
        name.endswith("num_batches_tracked") or ".net.0." in name or ".net.4." in name or "fc_logvar" in name
        for name in rest
    )
    leaves = jax.tree.leaves((found.variables, found.discriminator))
    assert len(leaves) == len(rows)


@pytest.mark.parametrize(("data", "size"), [("ted_gesture", "paper"), ("ted_expressive", "small")])
def test_ha2g(data, size, nets, oracles, tmp_path):
    torch, skeleton = nets.torch, load_skeleton(data)
    config = presets.make(data, size, "release")
    audio_settings = config.model.audio.resnet_se
    audio = nets.Audio(
        3, skeleton.num_levels, audio_settings.blocks, audio_settings.channels, 128 // audio_settings.stem_stride[0]
    )
    stages = [nets.Generator(3 * len(level), *_settings(config)) for level in skeleton.levels]
    text = nets.Text(7, config.model.text.channels, config.model.text.layers)
    discriminator = _discriminator(nets, data, config, 0.01)
    _shaken(nets, oracles, audio, text, discriminator, *stages)
    content = nets.objects(WORDS, SPEAKERS, _mean(data)) | {
        "audio_dict": audio.state_dict(),
        "text_dict": text.state_dict(),
        "dis_dict": discriminator.state_dict(),
        **{f"gen_dict_{level}": stage.state_dict() for level, stage in enumerate(stages, 1)},
    }
    torch.save(content, tmp_path / "best.bin")
    found = read_released(read_torch(tmp_path / "best.bin"), size)
    assert found.assets.vocabulary.words == ("the", "hand", "rises") and list(found.assets.speakers) == SPEAKERS
    np.testing.assert_allclose(found.assets.skeleton.mean_directions.ravel(), _mean(data), rtol=1e-6)

    mel, seed = -80 * torch.rand(2, 128, 70), 0.3 * torch.randn(2, 4, skeleton.pose_dim)
    words, speaker = torch.randint(0, 5, (2, 34)), torch.tensor([0, 1])
    released_words = words + 2 * (words > 0)  # ours are padding, unknown and words; start and end lie between
    method, spec = generating_method_of(found.spec), found.spec
    speech = {"mel": mel.numpy(), "words": words.numpy()}
    features = jax.jit(method.encode_speech, static_argnums=0)(spec, found.variables, speech)
    style = np.stack([found.assets.speakers[name] for name in SPEAKERS])[speaker.numpy()]
    infer = functools.partial(spec.generator.apply, train=False, method="infer")
    ours = jax.jit(infer)(found.variables, features, style, seed.numpy())
    with torch.no_grad():
        theirs, blend = audio.feat_extractor(mel, speaker + 1)
        poses = nets.levels(
            skeleton.levels, data == "ted_expressive", stages, theirs, blend, released_words, speaker + 1, seed
        )
        oracles.assert_close(list(features[:3]), [it.numpy() for it in theirs])
        np.testing.assert_allclose(spec.generator.apply(found.variables, style, method="coordinate"), blend, atol=1e-5)
        contrastive = spec.generator.apply(found.variables, words.numpy(), train=False, method="encode_text")
        np.testing.assert_allclose(contrastive, text(released_words), atol=1e-5)
        for level, their_poses in zip(ours, poses, strict=True):
            np.testing.assert_allclose(level, their_poses, atol=1e-5)
        _compare_discriminator(nets, found, discriminator)
    _check_each_tensor_is_used_once(content, found)
    if size == "paper":  # the folder has every bit of the weights
        folder, _ = import_weights(tmp_path / "best.bin", tmp_path / "model")
        loaded = model_folder.load(folder)
        assert loaded.spec == found.spec
        jax.tree.map(np.testing.assert_array_equal, loaded.variables, found.variables)


@pytest.mark.parametrize("data", WIDTHS)
def test_trimodal(data, nets, oracles, tmp_path):
    torch = nets.torch
    config = presets.make(data, "small", "trimodal")
    generator = nets.Generator(WIDTHS[data], *_settings(config), slope=1.0, waveform=True)
    discriminator = _discriminator(nets, data, config, 1.0)
    _shaken(nets, oracles, generator, discriminator)
    content = nets.objects(WORDS, SPEAKERS, _mean(data)) | {
        "gen_dict": generator.state_dict(),
        "dis_dict": discriminator.state_dict(),
    }
    torch.save(content, tmp_path / "trimodal.bin")
    found = read_released(read_torch(tmp_path / "trimodal.bin"), "small")

    audio, words = 0.3 * torch.randn(2, 36_267), torch.randint(0, 5, (2, 34))
    seed, speaker = 0.3 * torch.randn(2, 4, WIDTHS[data]), torch.tensor([1, 0])
    method, spec = generating_method_of(found.spec), found.spec
    speech = {"audio": audio.numpy(), "words": words.numpy()}
    features = method.encode_speech(spec, found.variables, speech)
    style = np.stack([found.assets.speakers[name] for name in SPEAKERS])[speaker.numpy()]
    ours = method.sample(spec, found.variables, features, jnp.asarray(style), seed.numpy(), jnp.zeros((1, 34, 0)))
    known = torch.zeros(2, 34, WIDTHS[data] + 1)
    known[:, :4] = torch.cat([seed, torch.ones(2, 4, 1)], -1)
    with torch.no_grad():
        wave = generator.wave(audio[:, None]).transpose(1, 2)
        theirs = generator(known, wave, words + 2 * (words > 0), speaker + 1)
        np.testing.assert_allclose(ours, theirs, atol=1e-5)
        _compare_discriminator(nets, found, discriminator)
    _check_each_tensor_is_used_once(content, found)


@pytest.mark.parametrize("slope", [1.0, 0.2], ids=["release", "paper"])
@pytest.mark.parametrize(
    ("data", "latent_dim", "part"), [("ted_gesture", 32, "gen_dict"), ("ted_expressive", 128, "motion_ae")]
)
def test_auto_encoders(data, latent_dim, part, slope, nets, oracles, tmp_path):
    torch = nets.torch
    theirs = nets.PoseAutoencoder(WIDTHS[data], latent_dim, slope, is_gesture=data == "ted_gesture")
    _shaken(nets, oracles, theirs)
    content = {"pose_dim": WIDTHS[data], "latent_dim": latent_dim, part: theirs.state_dict()}
    torch.save(content, tmp_path / "autoencoder.bin")
    found = read_released(read_torch(tmp_path / "autoencoder.bin"))
    poses = 0.5 * torch.randn(3, 34, WIDTHS[data])
    assert found.spec.generator.slope == 1.0
    generator = found.spec.generator.clone(slope=slope)
    latents = generator.apply(found.variables, poses.numpy(), train=False, method="encode")
    with torch.no_grad():
        np.testing.assert_allclose(latents, theirs.encode(poses), atol=1e-5)
        restored = generator.apply(found.variables, poses.numpy(), train=False)
        np.testing.assert_allclose(restored, theirs.decoder(theirs.encode(poses)), atol=1e-5)
    _check_each_tensor_is_used_once(content, found)
