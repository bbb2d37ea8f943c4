"""The methods of Table 1, HA2G as released and the pose auto-encoder, as changes to HA2G on the same data.

Widths that `config.sized` has reduced stay reduced; widths that only one method has are reduced here.
"""

from typing import Any

import ml_collections

from ha2g_jax.config.settings import Config

_PAPER = ("", "paper")


def ha2g(config: Config, size: str) -> None:
    """Set up HA2G, which `config.paper` describes."""


def ha2g_release(config: Config, size: str) -> None:
    """Set up HA2G with the weights, rates and batch size of the authors' public code and the networks of the paper.

    The contrastive term stays that of Eq. 2 with its weight; the public code has a term of another form.
    """
    config.name = "ha2g_release"
    has_fingers = config.skeleton == "ted_expressive"
    config.loss.ha2g.weights.gan = 5.0
    config.loss.ha2g.weights.huber = 250.0 if has_fingers else 70.0
    config.train.warmup_epochs = 11  # the GAN term counts from the twelfth epoch on
    if size in _PAPER:
        config.train.batch_size = 96 if has_fingers else 256
    _optimizer(config, size, 5e-4, 1e-4)


def release(config: Config, size: str) -> None:
    """Set up HA2G as `ha2g_release` with the networks of the public code in place of the paper's."""
    ha2g_release(config, size)
    config.name = "release"
    config.model.architecture = "release"
    config.model.text.receptive_field = "causal"
    config.model.identity.kind = "speakers"
    config.model.identity.feature_dim = 16


def seq2seq(config: Config, size: str) -> None:
    """Set up Attention Seq2Seq (Yoon et al. 2019): from words to poses."""
    _rename(config, "seq2seq", "mse", {"mse": 250.0, "continuity": 0.1, "variance": 25.0}, audio="none")
    config.model.identity.kind = "none"
    _widths(config, size, hidden_dim=200, layers=2, dropout=0.1)
    config.model.text.receptive_field = "causal"
    config.train.clip_norm = 5.0
    _optimizer(config, size, 1e-4)


def speech2gesture(config: Config, size: str) -> None:
    """Set up Speech2Gesture (Ginosar et al. 2019): from a spectrogram to poses, with a discriminator of motion."""
    settings = {"gan": "least_squares"}
    _rename(config, "speech2gesture", "l1", {"l1": 100.0, "gan": 10.0}, audio="spectrogram", **settings)
    config.model.legacy = False  # True for the version that HA2G was compared with: swapped axes, second differences
    config.model.identity.kind = "none"
    channels = _of(size, (64, 128, 256), (16, 32, 64), (4, 4, 8))
    config.model.audio.spectrogram = ml_collections.ConfigDict({"channels": channels})
    _widths(config, size, hidden_dim=256, layers=5, dropout=0.0)
    config.model.inferer.layers = 5
    config.model.discriminator.hidden_dim = _of(size, 64, 64, 8)
    config.train.warmup_epochs = 0
    _optimizer(config, size, 1e-3, 2e-4)


def joint_embedding(config: Config, size: str) -> None:
    """Set up Joint Embedding (Ahuja and Morency 2019): speech and poses share one latent space."""
    _rename(config, "joint_embedding", "l1", {"l1": 1.0}, audio="waveform")
    config.model.identity.kind = "none"
    config.model.context = ml_collections.ConfigDict()
    config.model.context.hidden_dim = _of(size, 256, 64, 8)
    config.model.context.layers = 2
    _widths(config, size, hidden_dim=300, layers=4, dropout=0.3)
    config.model.text.receptive_field = "causal"
    config.model.text.channels = _of(size, 200, 64, 8)
    config.model.text.layers = 2
    _optimizer(config, size, 5e-4)


def trimodal(config: Config, size: str) -> None:
    """Set up Trimodal (Yoon et al. 2020): from audio, words and a speaker to poses, with a discriminator."""
    settings = {name: config.loss.ha2g[name] for name in ("gan", "huber_delta", "style_clip")}
    weights = {"gan": 5.0, "huber": 500.0, "style": 0.05, "kld": 0.1}
    _rename(config, "trimodal", "huber", weights, audio="waveform", **settings)
    config.model.identity.kind = "speakers"
    config.model.identity.feature_dim = 16
    _widths(config, size, hidden_dim=300, layers=4, dropout=0.3)
    config.model.discriminator.layers = _of(size, 4, 4, 1)
    config.model.text.receptive_field = "causal"
    if size in _PAPER:
        config.train.warmup_epochs = 11  # adversarial terms count in epochs after the tenth, which begin with 0
    _optimizer(config, size, 5e-4, 1e-4)


def autoencoder(config: Config, size: str) -> None:
    """Set up the pose auto-encoder of FGD, whose networks have one size, so that distances can be compared."""
    weights = {"reconstruction": 1.0, "velocity": 1.0, "cosine": 0.001}
    _rename(config, "autoencoder", "total", weights, audio="none")
    config.model.identity.kind = "none"
    config.train.batch_size = _of(size, 64, 64, 16)
    config.train.steps = _of(size, 100_000, 4000, 60)
    config.train.validate_every = config.train.checkpoint_every = _of(size, 1000, 500, 30)
    config.train.warmup_epochs = 0
    config.train.schedule = "cosine"
    config.train.learning_rate = 5e-4


METHODS = {
    "ha2g": ha2g,
    "ha2g_release": ha2g_release,
    "release": release,
    "seq2seq": seq2seq,
    "speech2gesture": speech2gesture,
    "joint_embedding": joint_embedding,
    "trimodal": trimodal,
    "autoencoder": autoencoder,
}

# size -> method -> settings that its trials on the validation split chose, see docs/results/protocol.md
TUNED: dict[str, dict[str, dict[str, float]]] = {
    "study": {
        "ha2g": {"train.learning_rate": 3e-3, "loss.ha2g.weights.style": 0.01},
        "seq2seq": {"train.learning_rate": 1e-3, "loss.seq2seq.weights.variance": 25.0},
        "speech2gesture": {"train.learning_rate": 3e-3, "loss.speech2gesture.weights.gan": 1.0},
        "joint_embedding": {"train.learning_rate": 3e-3, "loss.joint_embedding.weights.l1": 10.0},
        "trimodal": {"train.learning_rate": 3e-3, "loss.trimodal.weights.style": 0.01},
    }
}


def _rename(
    config: Config, method: str, best_by: str, weights: dict[str, float], *, audio: str, **settings: Any
) -> None:
    config.name = config.method = method
    config.model.audio.kind = audio
    config.loss = ml_collections.ConfigDict({method: {"weights": weights, **settings}})
    config.train.best_by = f"loss/{best_by}"


def _widths(config: Config, size: str, hidden_dim: int, layers: int, dropout: float) -> None:
    inferer = config.model.inferer
    if size in _PAPER:
        inferer.hidden_dim, inferer.layers, inferer.dropout = hidden_dim, layers, dropout


def _optimizer(config: Config, size: str, rate: float, discriminator_rate: float | None = None) -> None:
    if size in _PAPER:
        config.train.learning_rate = rate
    config.train.discriminator_learning_rate = config.train.learning_rate * (discriminator_rate or rate) / rate


def _of(size: str, paper: Any, small: Any, debug: Any) -> Any:
    return paper if size in _PAPER else debug if size == "debug" else small
