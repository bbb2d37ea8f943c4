"""The configuration of a run: the settings of the paper, and smaller sizes.

`experiments/configs/*.py` start from `paper()` and change the settings for their data set. A config is one
`ml_collections.ConfigDict`. Only the launcher, the command line, checkpoints and the functions that build networks and
objectives read it; elsewhere modules take their own fields and functions take arguments.
"""

from typing import Any, TypeAlias

import ml_collections

from ha2g_jax.config import renames as config_renames
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown

# An ml_collections.ConfigDict, whose settings have no types that a type checker could know.
Config: TypeAlias = Any

MIN_FPS, MAX_FPS = 15, 30  # frames per second that features and networks can be derived for


def paper(skeleton: str) -> Config:
    """Return the config of HA2G with the sizes and settings of the paper.

    Args:
        skeleton: name of the skeleton of the data, "ted_expressive" or "ted_gesture".
    """
    config = ml_collections.ConfigDict()
    config.name = "ha2g"
    config.method = "ha2g"  # a name in ha2g_jax.methods.TRAINABLE
    config.seed = 0
    config.skeleton = skeleton

    config.data = ml_collections.ConfigDict()
    config.data.path = ""  # folder of records; "talk" builds the Talk corpus in the user's cache
    config.data.num_frames = 34  # N
    config.data.num_seed_frames = 4  # M
    config.data.num_reference_images = 4  # images of a speaker that E_ID takes; equal to M in the paper
    config.data.fps = 15
    config.data.image_size = 224
    config.data.jitter = 0  # largest number of frames by which a training window starts late, at random
    config.data.mirror = 0.0  # fraction of training windows that are mirrored left to right, with another identity
    config.data.vocal_tract = 0.0  # largest fraction by which a vocal tract is made longer or shorter, at random
    config.data.equalizer_db = 0.0  # largest number of dB by which a band is made louder or quieter, at random
    config.data.reverb = 0.0  # fraction of training windows with the reverberation of a room
    config.data.gain_db = 0.0  # largest number of dB by which a training window is made quieter, at random
    config.data.noise = 0.0  # fraction of training windows with noise in the speech
    config.data.noise_snr_db = (10.0, 40.0)  # range of the signal-to-noise ratio in dB
    config.data.lookahead = 0.0  # fraction of training windows whose end is hidden, for generation while someone speaks
    config.data.workers = 0  # processes that read and decode clips; 0 for threads of this process
    config.data.cache_gib = 8.0  # GiB of memory for the decoded clips of a split, for all workers of this host

    config.model = ml_collections.ConfigDict()
    config.model.architecture = "paper"  # or "release": of ha2g, trimodal and autoencoder as in the public code
    config.model.recompute = False  # compute activations of ResNets again in the backward pass instead of keeping them
    config.model.audio = ml_collections.ConfigDict()
    config.model.audio.kind = "resnet_se"  # or "whisper" (D5); baselines have "spectrogram", "waveform" or "none"
    config.model.audio.resnet_se = ml_collections.ConfigDict(
        {"blocks": (3, 4, 6, 3), "channels": (32, 64, 128, 256), "stem_stride": (1, 1)}
    )
    config.model.audio.weights = ""  # for "whisper": a Hugging Face folder, such as openai/whisper-tiny.en
    config.model.audio.whisper = ml_collections.ConfigDict(  # sizes of the encoder, by default those of tiny
        {"num_mels": 80, "d_model": 384, "layers": 4, "heads": 6, "ffn_dim": 1536}
    )
    config.model.audio.levels = ("low", "mid", "high")  # levels that the style coordinator blends
    config.model.audio.feature_dim = 32
    config.model.text = ml_collections.ConfigDict()
    config.model.text.kind = "tcn"  # or, in Trimodal, "none": gestures from sound alone
    config.model.text.embedding_dim = 300
    config.model.text.vectors = ""  # word vectors to start from: fastText, GloVe or word2vec file
    config.model.text.channels = 300
    config.model.text.layers = 4
    config.model.text.receptive_field = "centred"  # D4: "centred" (16 words) or "causal" (31, past only)
    config.model.text.dropout = 0.3
    config.model.identity = ml_collections.ConfigDict()
    config.model.identity.kind = "images"  # "images" (ResNet-18), "speakers" (a table) or, in baselines, "none"
    # Residual blocks of each stage of the ResNet, and channels of the first stage.
    config.model.identity.images = ml_collections.ConfigDict({"blocks": (2, 2, 2, 2), "width": 64})
    config.model.identity.feature_dim = 18
    config.model.inferer = ml_collections.ConfigDict()
    config.model.inferer.levels = ()  # numbers of the levels of the motion, from 1; () for all
    config.model.inferer.seed_level = "own"  # D7: the seed pose that a stage sees; "below" in older models
    config.model.inferer.coordinator = "levels"  # or "tied": the same blend of audio for all levels
    config.model.inferer.hidden_dim = 300
    config.model.inferer.layers = 4
    config.model.inferer.dropout = 0.3
    config.model.discriminator = ml_collections.ConfigDict()
    config.model.discriminator.hidden_dim = 64
    config.model.discriminator.layers = 4  # D17

    config.loss = ml_collections.ConfigDict()  # one part, named after the method
    config.loss.ha2g = ml_collections.ConfigDict()
    config.loss.ha2g.weights = ml_collections.ConfigDict(  # those of the paper, but for "physical" (0.1, D18)
        {"gan": 1.0, "huber": 200.0, "physical": 0.01, "style": 0.05, "kld": 0.1, "contrastive": 0.1}
    )
    config.loss.ha2g.version = 2  # of the scales of the terms, docs/objective.md; runs of version 1 cannot be continued
    config.loss.ha2g.gan = "non_saturating"  # or "minimax", Eq. 6, or "least_squares"
    config.loss.ha2g.huber_delta = 0.1  # D8; the weight of the Huber term is that of one level of the motion, D14
    config.loss.ha2g.temperature = 0.07
    config.loss.ha2g.negatives = ("low", "mid", "high")  # audio levels in the denominator of Eq. 2
    config.loss.ha2g.style_delta = 0.05  # D15
    config.loss.ha2g.style_clip = 1000.0

    config.train = ml_collections.ConfigDict()
    config.train.steps = 200_000
    config.train.batch_size = 128
    config.train.learning_rate = 1e-4
    config.train.discriminator_learning_rate = 1e-4
    config.train.betas = (0.5, 0.999)
    config.train.schedule = "constant"  # or "cosine": both rates fall to 0 at the last step
    config.train.clip_norm = 0.0  # largest norm of the gradient of a network; 0 for no limit
    config.train.ema = 0.0  # decay of the running average of the generator; 0 for no average
    config.train.dtype = "float32"  # of activations, or "bfloat16"; parameters, statistics and losses stay float32
    config.train.accumulate = 1  # number of parts of a batch; the same update in less memory
    config.train.init_from = (
        ""  # model whose weights training starts from: "demo", a folder, or hf://OWNER/NAME@REVISION
    )
    config.train.warmup_epochs = 10  # D9: epochs before the GAN term is used
    config.train.log_every = 50
    config.train.validate_every = 1000
    config.train.checkpoint_every = 1000
    config.train.keep = 2  # number of latest checkpoints to keep, besides the best
    config.train.best_by = "loss/huber"  # the best checkpoint has the least mean of this over the validation split
    config.train.sample_every = 0  # steps between videos of a validation clip; 0 for no videos
    config.train.wandb = ""  # project of Weights & Biases; "" for no report
    config.train.devices = 0  # number of devices to use; 0 for all
    return config


def from_json(values: Any) -> Config:
    """Return a stored config, locked; settings that were added later have the values of `paper`.

    Old names of settings are read, see `config_renames`. A model folder stores neither losses nor settings of training,
    so that its config has neither. Sizes are checked where networks are built from them.

    Args:
        values: plain values of config.json.

    Raises:
        ValueError: `values` are not a config.
    """
    try:
        return _from_json(values)
    except (KeyError, TypeError, AttributeError, OverflowError) as error:
        raise ValueError(str(error)) from error


def _from_json(values: Any) -> Config:
    if not isinstance(values, dict) or not isinstance(values.get("skeleton"), str):
        raise TypeError("no skeleton" if isinstance(values, dict) else "not an object of JSON")
    values = config_renames.with_new_names(values)[0]
    config = paper(values["skeleton"])
    stored = values.get("loss", {})
    for method in set(config.loss) - set(stored):
        del config.loss[method]
    for method in config.loss:
        config.loss[method].weights = ml_collections.ConfigDict()  # a term that is not stored did not exist
    config.update(values)
    if "train" not in values:
        del config.train
    return config.lock()


def check_fps(fps: float, name: str) -> None:
    """Check that features and networks can be derived for a frame rate.

    Args:
        fps: frames per second.
        name: name of the rate in the error message.

    Raises:
        UserError: the rate is not a whole number from 15 to 30.
    """
    if fps not in range(MIN_FPS, MAX_FPS + 1):
        raise UserError(
            f"{name} is {fps:g}, expected a whole number from {MIN_FPS} to {MAX_FPS}: make the corpus at such a rate "
            "(--fps of ha2g data make-talk, import-bvh and import-smplx) and set --config.data.fps to it"
        )


def small(config: Config) -> Config:
    """Return the config with sizes that two CPU cores train in about an hour."""
    config.data.image_size = 32
    config.model.audio.resnet_se.blocks = (1, 1, 1, 1)
    config.model.audio.resnet_se.channels = (16, 32, 64, 128)
    config.model.audio.resnet_se.stem_stride = (4, 1)
    config.model.text.embedding_dim = 64
    config.model.text.channels = 64
    config.model.identity.images.width = 8
    config.model.inferer.hidden_dim = 64
    config.model.inferer.layers = 2
    config.model.inferer.dropout = 0.0
    config.train.steps = 8000
    config.train.batch_size = 64
    config.train.learning_rate = 5e-4
    config.train.log_every = 20
    config.train.validate_every = 500
    config.train.checkpoint_every = 500
    return config


def medium(config: Config) -> Config:
    """Return the config with the sizes of the demo model; a step takes more than twice as long as a small one."""
    config = small(config)
    config.model.audio.resnet_se.blocks = (2, 2, 2, 1)
    config.model.audio.resnet_se.channels = (32, 64, 128, 192)
    config.model.inferer.hidden_dim = 128
    return config


def study(config: Config) -> Config:
    """Return the config with sizes for dozens of runs in some hours on two CPU cores, to compare methods."""
    config = small(config)
    config.model.inferer.layers = 1
    config.train.steps = 1000
    config.train.warmup_epochs = 1  # ten epochs are longer than a run
    config.train.batch_size = 32
    config.train.learning_rate = 3e-3
    config.train.schedule = "cosine"
    config.train.validate_every = 200
    config.train.checkpoint_every = 500
    return config


def debug(config: Config) -> Config:
    """Return the config with the smallest sizes, for tests."""
    config = small(config)
    config.data.image_size = 32
    config.model.audio.resnet_se.channels = (8, 8, 16, 32)
    config.model.text.embedding_dim = 8
    config.model.text.channels = 8
    config.model.text.layers = 1
    config.model.identity.images.blocks = (1, 1, 1, 1)
    config.model.identity.images.width = 4
    config.model.inferer.hidden_dim = 8
    config.model.inferer.layers = 1
    config.model.discriminator.hidden_dim = 8
    config.model.discriminator.layers = 1
    config.train.steps = 2
    config.train.batch_size = 4
    config.train.warmup_epochs = 0
    config.train.log_every = 1
    config.train.validate_every = 2
    config.train.checkpoint_every = 2
    config.train.devices = 1
    return config


SIZES = {"paper": lambda config: config, "medium": medium, "small": small, "study": study, "debug": debug}


def sized(config: Config, size: str) -> Config:
    """Return the config at one of `SIZES`.

    Args:
        config: settings of the paper, which are changed.
        size: name of the size; "" for that of the paper.

    Raises:
        UserError: there is no such size.
    """
    if size and size not in SIZES:
        raise UserError(f"the config has no size '{shown(size)}'; expected one of {', '.join(SIZES)}")
    return SIZES[size or "paper"](config)
