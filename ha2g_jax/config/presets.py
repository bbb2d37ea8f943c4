"""Configs by name: the methods of Table 1 on each kind of data at each size, and the rows of Tables 3, 4 and 11.

    presets.make("talk", "small")                                          # HA2G
    presets.make("ted_gesture", method="trimodal")                         # a baseline
    presets.make("talk", "study", changes=presets.TABLES["table4"]["Holistic"])

A preset is `settings.paper` and changes of single settings, by dotted name: first those of the data, then those of the
method, of the size, and of the row of a table. A later change wins.
"""

import itertools
from collections.abc import Mapping
from typing import Any, NamedTuple

from ha2g_jax.config.settings import Config, change, paper
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown

Changes = Mapping[str, Any]


_SPEAKERS = {"model.identity.kind": "speakers"}  # of data without images

# Kind of data -> skeleton, and changed settings.
DATA: dict[str, tuple[str, Changes]] = {
    # Windows start every 10 frames at 15 fps; with the jitter, training sees every possible start.
    "talk": ("ted_expressive", {"data.path": "talk", "data.jitter": 9}),
    "ted_expressive": ("ted_expressive", _SPEAKERS),
    "ted_gesture": ("ted_gesture", _SPEAKERS),
    "bvh": ("ted_expressive", {"data.jitter": 9, **_SPEAKERS}),
    "video": ("ted_expressive", {"data.jitter": 9}),
}

_SMALL = {  # trains in one to two hours on two CPU cores
    "data.image_size": 32,
    "model.audio.resnet_se.blocks": (1, 1, 1, 1),
    "model.audio.resnet_se.channels": (16, 32, 64, 128),
    "model.audio.resnet_se.stem_stride": (4, 1),
    "model.text.embedding_dim": 64,
    "model.text.channels": 64,
    "model.identity.images.width": 8,
    "model.inferer.hidden_dim": 64,
    "model.inferer.layers": 2,
    "model.inferer.dropout": 0.0,
    "train.steps": 8000,
    "train.batch_size": 64,
    "train.learning_rate": 5e-4,
    "train.discriminator_learning_rate": 1e-4,
    "train.log_every": 20,
    "train.validate_every": 500,
    "train.checkpoint_every": 500,
}
SIZES: dict[str, Changes] = {
    "paper": {},
    "medium": _SMALL  # the size of the demo model; a step takes more than twice as long as at size "small"
    | {
        "model.audio.resnet_se.blocks": (2, 2, 2, 1),
        "model.audio.resnet_se.channels": (32, 64, 128, 192),
        "model.inferer.hidden_dim": 128,
    },
    "small": _SMALL,
    "study": _SMALL  # dozens of runs in some hours on two CPU cores, to compare methods
    | {
        "model.inferer.layers": 1,
        "train.steps": 1000,
        "train.warmup_epochs": 1,  # ten epochs are longer than a run
        "train.batch_size": 32,
        "train.learning_rate": 3e-3,
        "train.schedule": "cosine",
        "train.validate_every": 200,
    },
    "debug": _SMALL  # for tests
    | {
        "model.audio.resnet_se.channels": (8, 8, 16, 32),
        "model.text.embedding_dim": 8,
        "model.text.channels": 8,
        "model.text.layers": 1,
        "model.identity.images.blocks": (1, 1, 1, 1),
        "model.identity.images.width": 4,
        "model.inferer.hidden_dim": 8,
        "model.inferer.layers": 1,
        "model.discriminator.hidden_dim": 8,
        "model.discriminator.layers": 1,
        "train.steps": 2,
        "train.batch_size": 4,
        "train.warmup_epochs": 0,
        "train.log_every": 1,
        "train.validate_every": 2,
        "train.checkpoint_every": 2,
        "train.devices": 1,
    },
}


class MethodPreset(NamedTuple):
    """Changes of settings for a method.

    Attributes:
        changes: changes at the size of its paper.
        on: key of `DATA` -> further changes.
        at: key of `SIZES` -> further changes; the rates and weights in those of "study" were chosen by trials on the
            validation split, see docs/results/README.md.
        method: name of the method, a key of `settings.OF_METHOD`; "" for the name of the preset.
    """

    changes: Changes
    on: Mapping[str, Changes] = {}
    at: Mapping[str, Changes] = {}
    method: str = ""


_ON_TALK = {"talk": {"loss.ha2g.weights.contrastive": 2.0}}  # D19
_RELEASE = {
    "loss.ha2g.weights.gan": 5.0,
    "loss.ha2g.weights.huber": 250.0,
    "train.batch_size": 96,
    "train.learning_rate": 5e-4,
    "train.warmup_epochs": 11,  # the GAN term counts from the twelfth epoch on
}
_RELEASE_ON = _ON_TALK | {"ted_gesture": {"loss.ha2g.weights.huber": 70.0, "train.batch_size": 256}}
_STUDY_HA2G = {"loss.ha2g.weights.style": 0.01}
_FIFTH = {"train.discriminator_learning_rate": 3e-3 * 0.2}  # of the learning rate of a study
# Methods without a discriminator do not read it; their published runs have this value.
_UNREAD = {"train.discriminator_learning_rate": 3e-3}
_CAUSAL = {"model.text.receptive_field": "causal"}
_SMALL_S2G = {"model.audio.spectrogram.channels": (16, 32, 64), "model.inferer.layers": 5}
_SMALL_JOINT = {"model.context.hidden_dim": 64}
_SMALL_AUTOENCODER = {"train.steps": 4000}

METHODS: dict[str, MethodPreset] = {
    "ha2g": MethodPreset({}, on=_ON_TALK, at={"study": _STUDY_HA2G}),
    "energy_ha2g": MethodPreset(  # an HA2G that samples, not in the paper
        {"train.best_by": "loss/energy"},
        on={"talk": {"loss.energy_ha2g.weights.contrastive": 2.0}},
    ),
    # The weights, rates and batch size of the authors' public code with the networks of the paper. The contrastive term
    # stays that of Eq. 2 with its weight; the public code has a term of another form.
    "ha2g_release": MethodPreset(_RELEASE, on=_RELEASE_ON, at={"study": _FIFTH}, method="ha2g"),
    # The same with the networks of the public code.
    "release": MethodPreset(
        {
            **_RELEASE,
            **_CAUSAL,
            "model.architecture": "release",
            "model.identity.kind": "speakers",
            "model.identity.feature_dim": 16,
        },
        on=_RELEASE_ON,
        at={"study": _FIFTH},
        method="ha2g",
    ),
    "seq2seq": MethodPreset(  # Attention Seq2Seq (Yoon et al. 2019): words to poses
        {
            **_CAUSAL,
            "model.identity.kind": "none",
            "model.inferer.hidden_dim": 200,
            "model.inferer.layers": 2,
            "model.inferer.dropout": 0.1,
            "train.clip_norm": 5.0,
            "train.best_by": "loss/mse",
        },
        at={"study": {"train.learning_rate": 1e-3, **_UNREAD}},
    ),
    "speech2gesture": MethodPreset(  # Ginosar et al. 2019: a spectrogram to poses, with a discriminator of motion
        {
            "model.identity.kind": "none",
            "model.inferer.hidden_dim": 256,
            "model.inferer.layers": 5,
            "model.inferer.dropout": 0.0,
            "train.warmup_epochs": 0,
            "train.learning_rate": 1e-3,
            "train.discriminator_learning_rate": 2e-4,
            "train.best_by": "loss/l1",
        },
        at={
            "medium": _SMALL_S2G,
            "small": _SMALL_S2G,
            "study": {**_SMALL_S2G, **_FIFTH, "loss.speech2gesture.weights.gan": 1.0, "train.warmup_epochs": 0},
            "debug": {"model.audio.spectrogram.channels": (4, 4, 8), "model.inferer.layers": 5},
        },
    ),
    "joint_embedding": MethodPreset(  # Ahuja and Morency 2019: speech and poses share one latent space
        {
            **_CAUSAL,
            "model.identity.kind": "none",
            "model.text.channels": 200,
            "model.text.layers": 2,
            "train.learning_rate": 5e-4,
            "train.best_by": "loss/l1",
        },
        at={
            "medium": _SMALL_JOINT,
            "small": _SMALL_JOINT,
            "study": {**_SMALL_JOINT, **_UNREAD, "loss.joint_embedding.weights.l1": 10.0},
            "debug": {"model.context.hidden_dim": 8, "model.text.layers": 2},
        },
    ),
    "trimodal": MethodPreset(  # Yoon et al. 2020: audio, words and a speaker to poses, with a discriminator
        {
            **_CAUSAL,
            "model.identity.kind": "speakers",
            "model.identity.feature_dim": 16,
            "train.learning_rate": 5e-4,
            "train.warmup_epochs": 11,  # adversarial terms count in epochs after the tenth, which begin with 0
        },
        at={
            "medium": {"train.warmup_epochs": 10},
            "small": {"train.warmup_epochs": 10},
            "study": {**_FIFTH, "loss.trimodal.weights.style": 0.01},
        },
    ),
    "autoencoder": MethodPreset(  # of FGD; its networks have one size, so that distances can be compared
        {
            "model.identity.kind": "none",
            "train.batch_size": 64,
            "train.steps": 100_000,
            "train.warmup_epochs": 0,
            "train.schedule": "cosine",
            "train.learning_rate": 5e-4,
            "train.best_by": "loss/total",
        },
        at={
            "medium": _SMALL_AUTOENCODER,
            "small": _SMALL_AUTOENCODER,
            "study": {
                **_SMALL_AUTOENCODER,
                "train.batch_size": 64,
                "train.learning_rate": 5e-4,
                "train.validate_every": 500,
                "train.warmup_epochs": 0,
            },
            "debug": {
                "train.steps": 60,
                "train.batch_size": 16,
                "train.validate_every": 30,
                "train.checkpoint_every": 30,
            },
        },
    ),
}


def make(data: str, size: str = "", method: str = "ha2g", changes: Changes | None = None) -> Config:
    """Return the config of a method on a kind of data, keys of `METHODS`, `DATA` and `SIZES`.

    Changes are values by dotted names of settings, such as a row of `TABLES`.

    Raises:
        UserError: a name is unknown.
    """
    size = size or "paper"
    for kind, name, names in (("data", data, DATA), ("size", size, SIZES), ("method", method, METHODS)):
        if name not in names:
            raise UserError(f"no {kind} '{shown(name)}'; expected one of {', '.join(names)}")
    preset, (skeleton, of_data) = METHODS[method], DATA[data]
    config = paper(skeleton, preset.method or method)
    config.name = method
    of_method = (preset.changes, preset.on.get(data, {}), SIZES[size], preset.at.get(size, {}))
    for part in (of_data, *of_method, changes or {}):
        change(config, part)
    return config


def sized(skeleton: str, size: str) -> Config:
    """Return the config of HA2G at a size, a key of `SIZES`, for no particular kind of data."""
    return change(paper(skeleton), SIZES[size])


def parse(spec: str, method: str) -> Config:
    """Return the config of a method, a key of `METHODS`, for "DATA" or "DATA:SIZE".

    Raises:
        UserError: a name is unknown.
    """
    data, _, size = spec.partition(":")
    return make(data, size, method)


# Rows of Tables 3, 4 and 11: name of the row -> settings that differ from the full model.
FULL = "HA2G Full"

_ASR = {"model.audio.kind": "whisper", "loss.ha2g.weights.contrastive": 0.0}

TABLES: dict[str, dict[str, Changes]] = {
    "table3": {
        "low-level feature only": {"model.audio.levels": ("low",)},
        "mid-level feature only": {"model.audio.levels": ("mid",)},
        "high-level feature only": {"model.audio.levels": ("high",)},
        "HA2G without high-level negatives": {"loss.ha2g.negatives": ("low", "mid")},
        "HA2G without low/mid-level negatives": {"loss.ha2g.negatives": ("high",)},
        "HA2G without text": {"loss.ha2g.weights.contrastive": 0.0},
        "HA2G-ASR": _ASR,
        FULL: {},
    },
    # Levels of the motion: 1 head and shoulders, 2 elbows, 3 wrists, 4 to 6 the joints of the fingers.
    "table4": {
        "Holistic": {"model.inferer.levels": (6,)},
        "without hand hierarchy": {"model.inferer.levels": (1, 2, 3, 6)},
        "without body hierarchy": {"model.inferer.levels": (3, 4, 5, 6)},
        "same audio feature for all levels": {"model.inferer.coordinator": "tied"},
        "without physical loss": {"loss.ha2g.weights.physical": 0.0},
        FULL: {},
    },
    "table11": {
        "1": {"data.num_seed_frames": 1, "data.num_reference_images": 1},
        "4": {},
        "7": {"data.num_seed_frames": 7, "data.num_reference_images": 7},
    },
    # Rows for TED-Gesture, whose hierarchy has three levels and no fingers.
    "gesture_ablation": {
        "high-level only": {"model.audio.levels": ("high",)},
        "Holistic": {"model.inferer.levels": (3,)},
        "without physical loss": {"loss.ha2g.weights.physical": 0.0},
        "HA2G-ASR": _ASR,
        FULL: {},
    },
}

# The factorial study, see docs/results/factorial.md. Each control changes one thing and leaves the rest equal:
HOLISTIC, OTHER_TEXT, NO_COORDINATOR, ORACLE = "holistic", "text of another window", "no coordinator", "oracle"
CONTROLS: dict[str, Changes] = {
    HOLISTIC: {"model.inferer.levels": (6,)},
    OTHER_TEXT: {"loss.ha2g.text": "other"},
    NO_COORDINATOR: {"model.inferer.coordinator": "none"},
}
# Size -> widths of the GRU of holistic, of no coordinator and of both, which give as many parameters as the full model.
_WIDTHS = {"medium": (324, 126, 322), "small": (168, 62, 166), "debug": (44, 6, 40)}
_FACTORIAL_RECIPE = {
    "model.discriminator.layers": 1,
    "loss.ha2g.weights.style": 0.02,
    "loss.ha2g.weights.huber": 300.0,
    "loss.ha2g.huber_delta": 0.2,
    "loss.ha2g.weights.contrastive": 20.0,  # with the next setting, it lets the words affect the hands
    "loss.ha2g.weights.angle": 1000.0,
    "train.learning_rate": 2e-3,
    "train.schedule": "cosine",
    "train.warmup_epochs": 10_000,  # so that the GAN term is never used
}
_RECIPES: dict[str, Changes] = {
    "medium": _FACTORIAL_RECIPE
    | {
        "data.workers": 8,
        "train.batch_size": 256,
        "train.steps": 4500,
        "train.validate_every": 900,
        "train.checkpoint_every": 450,
    },
    "small": _FACTORIAL_RECIPE | {"train.steps": 4500, "train.validate_every": 750, "train.checkpoint_every": 450},
    "debug": {},
}


def factorial(size: str) -> dict[str, Changes]:
    """Return the settings of the factorial study at a size: the oracle, then the eight cells, the full model first.

    The name of a cell lists its controls, keys of `CONTROLS`.

    Raises:
        UserError: the study has no such size.
    """
    if size not in _RECIPES:
        raise UserError(f"the factorial study has no size {size}; expected one of {', '.join(_RECIPES)}")
    recipe, (holistic, uncoordinated, both) = _RECIPES[size], _WIDTHS[size]
    widths: dict[tuple[str, ...], int]
    widths = {(HOLISTIC,): holistic, (NO_COORDINATOR,): uncoordinated, (HOLISTIC, NO_COORDINATOR): both}
    rows: dict[str, Changes] = {ORACLE: {**recipe, "model.text.kind": "oracle"}}
    for count in range(len(CONTROLS) + 1):
        for controls in itertools.combinations(CONTROLS, count):
            changes = dict(recipe)
            for control in controls:
                changes |= CONTROLS[control]
            if width := widths.get(tuple(control for control in controls if control != OTHER_TEXT)):
                changes["model.inferer.hidden_dim"] = width
            rows[", ".join(controls) or FULL] = changes
    return rows


# Table 1 at equal size and with equal inputs, see docs/results/README.md: the baselines read the spectrogram and the
# images of the speaker through the encoders of HA2G, and none reads words.
_SEES = {"model.identity.kind": "images", "model.identity.feature_dim": 18}
_HEARS = {"model.audio.kind": "resnet_se", "model.text.kind": "none"}
# Size -> width of a baseline with which its generator has as many parameters as that of HA2G.
_EQUAL_WIDTHS = {
    "medium": {"seq2seq": 262, "speech2gesture": 281, "joint_embedding": 279, "trimodal": 315},
    "small": {"seq2seq": 140, "speech2gesture": 139, "joint_embedding": 147, "trimodal": 162},
    "study": {"seq2seq": 145, "speech2gesture": 104, "joint_embedding": 137, "trimodal": 169},
    "debug": {"seq2seq": 49, "speech2gesture": 39, "joint_embedding": 39, "trimodal": 44},
}


def equal(method: str, size: str) -> Changes:
    """Return the settings that give a baseline the inputs and the size of HA2G.

    Raises:
        UserError: there is no such width at this size.
    """
    if size not in _EQUAL_WIDTHS:
        raise UserError(f"no baselines as large as HA2G at size {size}; expected one of {', '.join(_EQUAL_WIDTHS)}")
    width = _EQUAL_WIDTHS[size][method]
    own = {
        "speech2gesture": {},  # it has its own encoder of the spectrogram
        "joint_embedding": {**_HEARS, "model.context.hidden_dim": width},
    }
    return {**_SEES, **own.get(method, _HEARS), "model.inferer.hidden_dim": width}
