"""The settings of a run: one table of names, defaults, ranges and meanings, from which a config is made and checked.

A config is one `ml_collections.ConfigDict`. Only the launcher, the command line, checkpoints and the functions that
build networks and objectives read it; elsewhere modules take their own fields and functions take arguments. D1 to D21
are decisions where the paper is silent, see docs/model.md.
"""

import reprlib
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, TypeAlias

import ml_collections

from ha2g_jax.config.ranges import FLAG, POSITIVE, TEXT, Range, below, number, one_of, several, so_that, some_of, whole
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.limits import (
    MAX_CHANNELS,
    MAX_IMAGE_SIZE,
    MAX_LAYERS,
    MAX_MODEL_FPS,
    MAX_REFERENCE_IMAGES,
    MAX_SEED,
    MAX_SETTING,
    MAX_TEXT_LAYERS,
    MAX_WHISPER_LAYERS,
    MAX_WINDOW_FRAMES,
    MIN_MODEL_FPS,
    MIN_WINDOW_FRAMES,
)
from ha2g_jax.skeleton import SKELETONS

# An ml_collections.ConfigDict, whose settings have no types that a type checker could know.
Config: TypeAlias = Any


class Setting(NamedTuple):
    """One row of the table: dotted name, default, range of possible values, and meaning."""

    name: str
    default: Any
    range: Range
    meaning: str


_FRACTION, _WEIGHT, _COUNT = number(0, 1), number(0), whole(0)
_SIZE, _LAYERS = whole(1, MAX_CHANNELS), whole(1, MAX_LAYERS)
_HIDDEN = whole(2, MAX_CHANNELS)  # half of it is used as a width too
_LEVELS = ("low", "mid", "high")
_GAN = one_of("non_saturating", "minimax", "least_squares")
# Squeeze and excitation divides channels by 8, the pixel shuffles before the heads by 4 and 16.
_STAGE_CHANNELS = so_that(
    several(whole(8, MAX_CHANNELS), 4),
    f"four whole numbers from 8 to {MAX_CHANNELS}, the third a multiple of 4, the fourth of 16",
    lambda values: values[2] % 4 == 0 and values[3] % 16 == 0,
)
# Four stages halve the 128 frequencies three times, and the kernels of the heads are up to 3 wide.
_STEM_STRIDE = so_that(several(whole(1, 16), 2), "(1 to 16, 1)", lambda values: values[1] == 1)
_BOUNDS = so_that(several(number(-MAX_SETTING), 2), "a lower and an upper bound", lambda values: values[0] <= values[1])

SETTINGS = (
    Setting("name", "ha2g", TEXT, "name of the preset, which the progress bar shows"),
    Setting("method", "ha2g", TEXT, "name of the method, such as ha2g or trimodal"),
    Setting("seed", 0, whole(0, MAX_SEED), "seed of all random choices"),
    Setting("skeleton", "", one_of(*SKELETONS), "skeleton of the data"),
    Setting("data.path", "", TEXT, 'folder of records; "talk" builds the Talk corpus in the user\'s cache'),
    Setting("data.num_frames", 34, whole(MIN_WINDOW_FRAMES, MAX_WINDOW_FRAMES), "number of frames in a window, N"),
    Setting("data.num_seed_frames", 4, whole(1, MAX_WINDOW_FRAMES), "number of frames in the seed pose, M"),
    Setting(
        "data.num_reference_images", 4, whole(1, MAX_REFERENCE_IMAGES), "number of images of a speaker; M in the paper"
    ),
    Setting("data.fps", 15, whole(MIN_MODEL_FPS, MAX_MODEL_FPS), "frames per second"),
    Setting("data.image_size", 224, whole(1, MAX_IMAGE_SIZE), "height and width of the images in pixels"),
    Setting("data.jitter", 0, _COUNT, "maximum random delay of the start of a training window, in frames"),
    Setting("data.mirror", 0.0, _FRACTION, "fraction of windows mirrored left to right, with another identity"),
    Setting("data.vocal_tract", 0.0, below(1), "maximum relative change of the vocal tract length"),
    Setting("data.equalizer_db", 0.0, _WEIGHT, "amplitude of a random frequency response, in dB"),
    Setting("data.reverb", 0.0, _FRACTION, "fraction of windows with the reverberation of a room"),
    Setting("data.gain_db", 0.0, _WEIGHT, "maximum attenuation of a window, in dB"),
    Setting("data.noise", 0.0, _FRACTION, "fraction of windows with noise in the speech"),
    Setting("data.noise_snr_db", (10.0, 40.0), _BOUNDS, "range of the signal-to-noise ratio, in dB"),
    Setting("data.lookahead", 0.0, _FRACTION, "fraction of windows whose end of speech is hidden, for streams"),
    Setting("data.workers", 0, _COUNT, "processes that read and decode clips; 0 to use threads"),
    Setting("data.cache_gib", 8.0, _WEIGHT, "GiB of decoded clips to cache, per split and host"),
    Setting("model.architecture", "paper", one_of("paper", "release"), "networks of the paper or of the public code"),
    Setting("model.recompute", False, FLAG, "recompute the activations of ResNets for the gradient to save memory"),
    Setting("model.audio.kind", "resnet_se", one_of("resnet_se", "whisper"), "encoder E_a, or that of HA2G-ASR (D5)"),
    Setting("model.audio.resnet_se.blocks", (3, 4, 6, 3), several(_LAYERS, 4), "blocks of each stage"),
    Setting("model.audio.resnet_se.channels", (32, 64, 128, 256), _STAGE_CHANNELS, "channels of each stage"),
    Setting("model.audio.resnet_se.stem_stride", (1, 1), _STEM_STRIDE, "stride along mel and time"),
    Setting("model.audio.weights", "", TEXT, "for whisper: a Hugging Face folder, such as openai/whisper-tiny.en"),
    Setting("model.audio.whisper.num_mels", 80, _SIZE, "mel bands; the sizes are by default those of tiny"),
    Setting("model.audio.whisper.d_model", 384, whole(4, MAX_CHANNELS), "channels, an even multiple of the heads"),
    Setting("model.audio.whisper.layers", 4, whole(1, MAX_WHISPER_LAYERS), "blocks"),
    Setting("model.audio.whisper.heads", 6, _SIZE, "heads of the attention"),
    Setting("model.audio.whisper.ffn_dim", 1536, _SIZE, "channels of the hidden layers"),
    Setting("model.audio.levels", _LEVELS, some_of(*_LEVELS), "levels that the style coordinator blends"),
    Setting("model.audio.feature_dim", 32, _SIZE, "size of an audio or text feature"),
    Setting("model.text.kind", "tcn", one_of("tcn"), "encoder E_t"),
    Setting("model.text.embedding_dim", 300, _SIZE, "size of a word vector"),
    Setting("model.text.vectors", "", TEXT, "word vectors to start from: fastText, GloVe or word2vec file"),
    Setting("model.text.channels", 300, _SIZE, "channels of the blocks"),
    Setting("model.text.layers", 4, whole(1, MAX_TEXT_LAYERS), "blocks"),
    Setting("model.text.receptive_field", "centred", one_of("centred", "causal"), "D4: 16 words, or 31 of the past"),
    Setting("model.text.dropout", 0.3, _FRACTION, "dropout rate"),
    Setting("model.identity.kind", "images", one_of("images", "speakers"), "E_ID: ResNet-18, or a table of speakers"),
    Setting("model.identity.images.blocks", (2, 2, 2, 2), several(_LAYERS, 4), "residual blocks of each stage"),
    Setting("model.identity.images.width", 64, _SIZE, "channels of the first stage"),
    Setting("model.identity.feature_dim", 18, _SIZE, "values of f_id"),
    Setting("model.inferer.levels", (), several(whole(1, MAX_LAYERS)), "levels of the motion, from 1; () for all"),
    Setting(
        "model.inferer.coordinator",
        "levels",
        one_of("levels", "tied", "none"),
        "tied: one blend for all levels; none: the GRU reads f_id",
    ),
    Setting("model.inferer.hidden_dim", 300, _HIDDEN, "size of the state of the GRU"),
    Setting("model.inferer.layers", 4, _LAYERS, "layers of the GRU"),
    Setting("model.inferer.dropout", 0.3, _FRACTION, "dropout rate between the layers of the GRU"),
    Setting("model.discriminator.hidden_dim", 64, _SIZE, "size of the state of the GRU"),
    Setting("model.discriminator.layers", 4, _LAYERS, "layers of the GRU (D17)"),
    Setting("model.discriminator.dropout", 0.3, _FRACTION, "dropout rate between the layers of the GRU"),
    Setting("train.steps", 200_000, whole(1), "steps of the run"),
    Setting("train.batch_size", 128, whole(1), "windows in a step, over all devices"),
    Setting("train.learning_rate", 1e-4, _WEIGHT, "learning rate of the generator"),
    Setting("train.discriminator_learning_rate", 1e-4, _WEIGHT, "learning rate of the discriminator"),
    Setting("train.betas", (0.5, 0.999), several(below(1), 2), "decay rates of the moments of Adam"),
    Setting("train.schedule", "constant", one_of("constant", "cosine"), "cosine: rates fall to 0 at the end"),
    Setting("train.clip_norm", 0.0, _WEIGHT, "largest norm of the gradient of a network; 0 for no limit"),
    Setting("train.ema", 0.0, below(1), "decay of the running average of the generator; 0 for no average"),
    Setting("train.dtype", "float32", one_of("float32", "bfloat16"), "type of activations; all else stays float32"),
    Setting(
        "train.accumulate",
        1,
        whole(1),
        "parts in which a batch is processed to save memory, a divisor of the batch",
    ),
    Setting("train.init_from", "", TEXT, 'model to start from: "demo", a folder, or hf://OWNER/NAME@REVISION'),
    Setting("train.warmup_epochs", 10, _COUNT, "epochs before the GAN term is used (D9)"),
    Setting("train.log_every", 50, whole(1), "steps between lines of metrics"),
    Setting("train.validate_every", 1000, whole(1), "steps between validations"),
    Setting("train.checkpoint_every", 1000, whole(1), "steps between checkpoints"),
    Setting("train.keep", 2, whole(1), "latest checkpoints to keep, besides the best"),
    Setting("train.best_by", "loss/huber", TEXT, "metric of the validation split that the best checkpoint minimises"),
    Setting("train.sample_every", 0, _COUNT, "steps between videos of a validation clip; 0 for no videos"),
    Setting("train.wandb", "", TEXT, 'project of Weights & Biases; "" for no report'),
    Setting("train.devices", 0, _COUNT, "devices to use; 0 for all"),
)

_NO_IDENTITY = Setting("model.identity.kind", "none", one_of("none"), "the method has no identity as an input")
_IMAGES = Setting("model.identity.kind", "none", one_of("none", "images"), "images: the mean of E_ID is the style")
_SOUND = Setting("model.audio.kind", "waveform", one_of("waveform", "resnet_se"), "samples of the speech, or E_a")
_WORDS = Setting("model.text.kind", "tcn", one_of("tcn", "none"), "none: gestures from sound alone")
_NO_AUDIO = Setting("model.audio.kind", "none", one_of("none"), "the method has no sound as an input")
_PAPER = Setting("model.architecture", "paper", one_of("paper"), "networks of the paper")


def _losses(method: str, weights: Mapping[str, float], *settings: Setting) -> tuple[Setting, ...]:
    """Return the rows of `config.loss.<method>`: the weights of the terms and their settings."""
    rows = [Setting(f"weights.{name}", weight, _WEIGHT, f"weight of {name}") for name, weight in weights.items()]
    return tuple(row._replace(name=f"loss.{method}.{row.name}") for row in (*rows, *settings))


_GAN_KIND = Setting("gan", "non_saturating", _GAN, "minimax is Eq. 6")
_HUBER_DELTA = Setting("huber_delta", 0.1, POSITIVE, "difference at which Huber's parabola becomes a line (D8)")
_TEMPERATURE = Setting("temperature", 0.07, POSITIVE, "tau of Eq. 2")
_NEGATIVES = Setting("negatives", _LEVELS, some_of(*_LEVELS), "levels of the audio in the denominator of Eq. 2")
_STYLE_CLIP = Setting("style_clip", 1000.0, POSITIVE, "epsilon of Eq. 7")

# Settings of a method that are added to `SETTINGS` or replace one of them; weights and settings of its losses.
OF_METHOD: dict[str, tuple[Setting, ...]] = {
    "ha2g": (
        Setting("model.text.kind", "tcn", one_of("tcn", "oracle"), "oracle: f_t replaces f_high, a control"),
        *_losses(
            "ha2g",
            {  # those of the paper, except for D18 and D21
                "gan": 1.0,
                "huber": 200.0,  # weight of one level (D14)
                "physical": 0.01,  # D18
                "angle": 0.0,  # D21
                "style": 0.05,
                "kld": 0.1,
                "contrastive": 0.1,
            },
            _GAN_KIND,
            _HUBER_DELTA,
            _TEMPERATURE,
            _NEGATIVES,
            Setting("style_delta", 0.05, POSITIVE, "delta of Huber's function in the style term (D15)"),
            _STYLE_CLIP,
            Setting(
                "text", "own", one_of("own", "other"), "text of the contrastive term; other: that of another window"
            ),
        ),
    ),
    "energy_ha2g": (  # the networks of HA2G with noise, see `methods.energy_ha2g`
        _PAPER,
        Setting("model.inferer.noise_dim", 32, whole(1, MAX_CHANNELS), "channels of the noise"),
        *_losses(
            "energy_ha2g",
            {"energy": 100.0, "velocity": 400.0, "kld": 0.1, "contrastive": 0.1},
            *(_TEMPERATURE, _NEGATIVES),
        ),
    ),
    "seq2seq": (
        *(_IMAGES, _WORDS, _PAPER),
        Setting("model.audio.kind", "none", one_of("none", "resnet_se"), "resnet_se: E_a instead of the words"),
        *_losses("seq2seq", {"mse": 250.0, "continuity": 0.1, "variance": 25.0}),
    ),
    "speech2gesture": (
        *(_IMAGES, _PAPER),
        Setting("model.audio.kind", "spectrogram", one_of("spectrogram"), "log-mel spectrogram"),
        Setting("model.audio.spectrogram.channels", (64, 128, 256), several(_SIZE, least=1), "channels of each stage"),
        Setting("model.legacy", False, FLAG, "as the authors of HA2G had it: swapped axes, second differences"),
        *_losses("speech2gesture", {"l1": 100.0, "gan": 10.0}, _GAN_KIND._replace(default="least_squares")),
    ),
    "joint_embedding": (
        *(_IMAGES, _SOUND, _WORDS, _PAPER),
        Setting("model.context.hidden_dim", 256, _HIDDEN, "size of the state of the GRU that reads the speech"),
        Setting("model.context.layers", 2, _LAYERS, "its layers"),
        *_losses("joint_embedding", {"l1": 1.0}),
    ),
    "trimodal": (
        *(_SOUND, _WORDS),
        Setting("model.identity.kind", "speakers", one_of("speakers", "images"), "a table of speakers, or E_ID"),
        *_losses(
            "trimodal",
            {"gan": 5.0, "huber": 500.0, "style": 0.05, "kld": 0.1},
            *(_GAN_KIND, _HUBER_DELTA, _STYLE_CLIP),
        ),
    ),
    "autoencoder": (
        *(_NO_IDENTITY, _NO_AUDIO),
        *_losses("autoencoder", {"reconstruction": 1.0, "velocity": 1.0, "cosine": 0.001}),
    ),
}

TRAINING = ("loss", "train")  # parts that the config of a model does not have
# Parts whose settings become the fields of one object, so that there can be no others.
_CLOSED = ("model.audio.resnet_se", "model.audio.whisper", "model.identity.images", "model.discriminator")


def table(method: str) -> tuple[Setting, ...]:
    """Return the settings of a method, in the order of a config."""
    own = {row.name: row for row in OF_METHOD.get(method, ())}
    rows = [own.pop(row.name, row) for row in SETTINGS]
    first = next(index for index, row in enumerate(rows) if row.name.startswith("train."))
    return (*rows[:first], *own.values(), *rows[first:])


def paper(skeleton: str, method: str = "ha2g") -> Config:
    """Return the config of a method, a key of `OF_METHOD`; that of HA2G has the sizes and settings of the paper."""
    config = ml_collections.ConfigDict()
    for row in table(method):
        *path, last = row.name.split(".")
        part: Any = config
        for name in path:
            if name not in part:
                part[name] = ml_collections.ConfigDict()
            part = part[name]
        part[last] = row.default
    config.skeleton, config.method = skeleton, method
    return config


def change(config: Config, changes: Mapping[str, Any]) -> Config:
    """Change settings of a config, by their dotted names, in place, and return it.

    Raises:
        UserError: there is no such setting, or the value has another type.
    """
    for name, value in changes.items():
        *path, last = name.split(".")
        part = value_of(config, ".".join(path)) if path else config
        if not isinstance(part, ml_collections.ConfigDict) or last not in part:
            raise UserError(f"no setting {name!r}; `ha2g train --help` lists all")
        try:
            part[last] = value
        except TypeError as error:
            raise UserError(f"{name} cannot be {value!r}; expected a value like {part[last]!r}") from error
    return config


def value_of(config: Config, name: str) -> Any:
    """Return the value of a setting by its dotted name, None if there is none."""
    value = config
    for key in name.split("."):
        value = value.get(key) if isinstance(value, ml_collections.ConfigDict) else None
    return value


def _names(config: Config, prefix: str = "") -> Iterator[str]:
    """Yield the dotted names of all settings of a config."""
    for key, value in config.items():
        if isinstance(value, ml_collections.ConfigDict):
            yield from _names(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}"


def from_json(values: Any) -> Config:
    """Return a stored config, locked; settings that are not stored have their defaults.

    A model folder stores neither losses nor settings of training, so that its config has neither. Values are checked
    where networks are built from them.

    Raises:
        ValueError: `values` are not a config.
    """
    try:
        config = paper(values["skeleton"], values.get("method", "ha2g"))
        config.update(values)
    except (KeyError, TypeError, AttributeError, OverflowError) as error:
        raise ValueError(str(error)) from error
    for part in set(TRAINING) - set(values):
        del config[part]
    return config.lock()


def check(config: Config, *, is_trained: bool = True) -> None:
    """Check that no setting of a config is missing and that each has a possible value.

    Whether it fits the data and the machine is another question, see `ha2g_jax.train.fits`. The config of a model,
    which is not `is_trained`, has neither losses nor settings of training.

    Raises:
        UserError: a setting is missing, unknown, of another type or outside its range.
    """
    method = value_of(config, "method")
    _check("method", method, one_of(*OF_METHOD))
    rows = [row for row in table(method) if is_trained or row.name.split(".")[0] not in TRAINING]
    for row in rows:
        _check(row.name, value_of(config, row.name), row.range)
    known = {row.name for row in rows}
    # The config of a model may have more settings, of an earlier version.
    for name in _names(config):
        if name not in known and (is_trained or name.rpartition(".")[0] in _CLOSED):
            raise UserError(f"unknown setting config.{shown(name)}; `ha2g train --help` lists all")
    data, whisper = config.data, config.model.audio.whisper
    _check("data.num_seed_frames", data.num_seed_frames, whole(1, data.num_frames // 2))  # half of a window
    channels = so_that(_SIZE, "an even multiple of the heads", lambda size: size % whisper.heads == size % 2 == 0)
    _check("model.audio.whisper.d_model", whisper.d_model, channels)
    if is_trained:
        size = config.train.batch_size
        divisor = so_that(whole(1), f"a divisor of config.train.batch_size, {size}", lambda parts: size % parts == 0)
        _check("train.accumulate", config.train.accumulate, divisor)
        terms = (f"loss/{name}" for name in (*config.loss[method].weights, "total"))
        _check("train.best_by", config.train.best_by, one_of(*terms))


def _check(name: str, value: Any, range_: Range) -> None:
    if value is None:
        raise UserError(f"config.{name} is missing, expected {range_.expected}: set --config.{name}")
    if not range_.contains(value):
        raise UserError(f"config.{name} is {reprlib.repr(value)}, expected {range_.expected}: set --config.{name}")


def check_fps(fps: float, name: str) -> None:
    """Check that features and networks can be derived for a frame rate; the error message calls it `name`.

    Raises:
        UserError: the rate is not a whole number from 15 to 30.
    """
    if fps not in range(MIN_MODEL_FPS, MAX_MODEL_FPS + 1):
        raise UserError(
            f"{name} is {fps:g}, expected a whole number from {MIN_MODEL_FPS} to {MAX_MODEL_FPS}: make the corpus at "
            "such a rate (--fps of ha2g data make-talk and import) and set --config.data.fps to it"
        )


def as_text(method: str = "ha2g") -> str:
    """Return the table of a method as text, one line for each setting."""
    rows = table(method)
    width = max(len(row.name) for row in rows)
    return "\n".join(
        f"{row.name:{width}}  {row.meaning} ({row.range.expected}; {row.default!r} by default)" for row in rows
    )
