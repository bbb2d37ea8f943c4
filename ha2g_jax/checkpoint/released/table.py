"""The entries of released files and their counterparts in our modules; docs/released_weights.md has the same table.

The names are those of the files, which an importer needs; everything else was written from a description of the
networks and not from their code. A row names one tensor of a file. Rows are made for the numbers of blocks, layers and
levels of a config, so that small networks can be tested.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.config.settings import Config

# Module of the discriminator's variables, which are checked but not kept.
DISCRIMINATOR = "discriminator"
# Input channels of the convolutions of the raw-waveform encoder, whose entries the description does not name.
_WAVEFORM_CHANNELS = (1, 16, 32, 64)
FIRST_WORD, FIRST_SPEAKER = 4, 1  # rows of the released tables; before them are marks, and a row that was never trained
_UNKNOWN = 3  # row of unknown words

_Shape = tuple[int, ...]


class Conversion(NamedTuple):
    """How a tensor of a released file becomes one of ours."""

    convert: Callable[[np.ndarray], np.ndarray]  # of the array in the file
    stored: Callable[[_Shape], _Shape]  # of the shape of our array to that in the file


SAME = Conversion(lambda array: array, lambda shape: shape)
# (outputs, inputs, *space) of a linear map or a convolution becomes (*space, inputs, outputs).
KERNEL = Conversion(
    lambda array: np.moveaxis(array, (0, 1), (-1, -2)), lambda shape: (shape[-1], shape[-2], *shape[:-2])
)
# (inputs, outputs, K) of a transposed convolution, the gradient of a correlation, becomes (K, inputs, outputs).
TRANSPOSED = Conversion(lambda array: np.moveaxis(array, 2, 0)[::-1], lambda shape: (shape[1], shape[2], shape[0]))
# (outputs, 1, 1), the norms of a weight-normalised convolution.
NORMS = Conversion(np.ravel, lambda shape: (*shape, 1, 1))
# The rows are padding, start, end, unknown and the words; ours padding, unknown and the words.
WORDS = Conversion(
    lambda table: np.concatenate([table[:1], table[_UNKNOWN:]]),
    lambda shape: (shape[0] + FIRST_WORD - 2, *shape[1:]),
)
# Row 0 belongs to no speaker.
SPEAKERS = Conversion(lambda table: table[FIRST_SPEAKER:], lambda shape: (shape[0] + FIRST_SPEAKER, *shape[1:]))


class Row(NamedTuple):
    """One tensor of a released file."""

    part: str  # key of the file, such as "gen_dict_1"
    name: str  # in the part
    target: str  # name of our variable, such as "params/pose_1/decoder/gru/weight_ih_l0"
    conversion: Conversion


Pairs = Iterator[tuple[str, str, Conversion]]  # name, target, conversion


def ha2g(config: Config, num_levels: int) -> list[Row]:
    """Return the rows of HA2G, whose config has the architecture "release"."""
    layers, text_layers = config.model.inferer.layers, config.model.text.layers
    rows = [
        *_rows("audio_dict", "feat_extractor.", "", _audio(config.model.audio.resnet_se.blocks)),
        *_rows("text_dict", "", "text", _text(text_layers)),
    ]
    for level in range(1, num_levels + 1):
        stage = f"pose_{level}"
        rows += _rows(f"gen_dict_{level}", "text_encoder.", f"{stage}/text", _text(text_layers))
        rows += _rows(f"gen_dict_{level}", "", f"{stage}/identity", _speaker())
        rows += _rows(f"gen_dict_{level}", "", f"{stage}/decoder", _decoder(layers))
    return rows + _rows("dis_dict", "", DISCRIMINATOR, _discriminator(config.model.discriminator.layers))


def trimodal(config: Config, tensors: Mapping[str, Any]) -> list[Row]:
    """Return the rows of Trimodal; the encoder of the waveform is found by the shapes of the arrays of "gen_dict"."""
    return [
        *_rows("gen_dict", "", "audio", _waveform(tensors)),
        *_rows("gen_dict", "text_encoder.", "text", _text(config.model.text.layers)),
        *_rows("gen_dict", "", "identity", _speaker()),
        *_rows("gen_dict", "", "decoder", _decoder(config.model.inferer.layers)),
        *_rows("dis_dict", "", DISCRIMINATOR, _discriminator(config.model.discriminator.layers)),
    ]


def autoencoder(part: str, encoder: str, *, has_mean: bool) -> list[Row]:
    """Return the rows of a pose auto-encoder; a further linear map may give the latent, as on TED-Gesture."""
    rows = _rows(part, f"{encoder}.", "encoder", _pose_encoder(has_mean=has_mean))
    return rows + _rows(part, "decoder.", "decoder", _pose_decoder())


def _rows(part: str, prefix: str, target: str, pairs: Pairs) -> list[Row]:
    rows = []
    for name, variable, conversion in pairs:
        collection, _, path = variable.partition("/")
        rows.append(Row(part, prefix + name, "/".join(filter(None, (collection, target, path))), conversion))
    return rows


def _affine(name: str, target: str, conversion: Conversion = KERNEL, *, has_bias: bool = True) -> Pairs:
    """A linear map or a convolution."""
    yield f"{name}.weight", f"params/{target}/kernel", conversion
    if has_bias:
        yield f"{name}.bias", f"params/{target}/bias", SAME


def _norm(name: str, target: str) -> Pairs:
    yield f"{name}.weight", f"params/{target}/scale", SAME
    yield f"{name}.bias", f"params/{target}/bias", SAME
    yield f"{name}.running_mean", f"batch_stats/{target}/mean", SAME
    yield f"{name}.running_var", f"batch_stats/{target}/variance", SAME


def _gru(layers: int) -> Pairs:
    for layer in range(layers):
        for direction in ("", "_reverse"):
            for kind in ("weight_ih", "weight_hh", "bias_ih", "bias_hh"):
                name = f"{kind}_l{layer}{direction}"
                yield f"gru.{name}", f"params/gru/{name}", SAME


def _audio(blocks: tuple[int, ...]) -> Pairs:
    yield from _affine("conv1", "audio/stem/conv")
    yield from _norm("bn1", "audio/stem/norm")
    for stage, count in enumerate(blocks, 1):
        for block in range(count):
            name, target = f"layer{stage}.{block}", f"audio/stage_{stage}/block_{block}"
            for number in (1, 2):
                yield from _affine(f"{name}.conv{number}", f"{target}/conv_{number}", has_bias=False)
                yield from _norm(f"{name}.bn{number}", f"{target}/norm_{number}")
            yield from _affine(f"{name}.se.fc.0", f"{target}/se/squeeze")
            yield from _affine(f"{name}.se.fc.2", f"{target}/se/excite")
            if stage > 1 and block == 0:
                yield from _affine(f"{name}.downsample.0", f"{target}/shortcut_conv", has_bias=False)
                yield from _norm(f"{name}.downsample.1", f"{target}/shortcut_norm")
    for head in ("low", "mid", "high"):
        yield from _affine(f"conv_{head}", f"audio/{head}/conv")
        yield from _norm(f"bn_{head}", f"audio/{head}/norm")
        yield from _affine(f"fc_{head}", f"audio/{head}/linear")
    yield "speaker_embedding.0.weight", "params/coordinator/embedding/embedding", SPEAKERS
    yield from _affine("speaker_embedding.1", "coordinator/linear_1")
    yield from _affine("fc1", "coordinator/linear_2")
    yield from _affine("fc2", "coordinator/linear_3")


def _text(layers: int) -> Pairs:
    yield "embedding.weight", "params/embedding/embedding", WORDS
    for block in range(layers):
        for number in (1, 2):
            name, target = f"tcn.network.{block}.conv{number}", f"params/block_{block}/conv_{number - 1}"
            yield f"{name}.weight_v", f"{target}/kernel", KERNEL
            yield f"{name}.weight_g", f"{target}/scale", NORMS
            yield f"{name}.bias", f"{target}/bias", SAME
    yield from _affine("decoder", "linear")


def _speaker() -> Pairs:
    yield "speaker_embedding.0.weight", "params/embedding/embedding", SPEAKERS
    yield from _affine("speaker_embedding.1", "linear")
    yield from _affine("speaker_mu", "mean")
    yield from _affine("speaker_logvar", "log_variance")


def _decoder(layers: int) -> Pairs:
    yield from _gru(layers)
    yield from _affine("out.0", "linear_1")
    yield from _affine("out.2", "linear_2")


def _discriminator(layers: int) -> Pairs:
    for number, place in enumerate((0, 3, 6), 1):
        yield from _affine(f"pre_conv.{place}", f"conv_{number}")
    for number, place in enumerate((1, 4), 1):
        yield from _norm(f"pre_conv.{place}", f"norm_{number}")
    yield from _gru(layers)
    yield from _affine("out", "linear_1")
    yield from _affine("out2", "linear_2")


def _waveform(tensors: Mapping[str, Any]) -> Pairs:
    """The encoder of raw speech, found by shapes: convolutions by their input channels, norms by their width."""
    shapes = {name: it.shape for name, it in tensors.items() if isinstance(name, str) and isinstance(it, np.ndarray)}
    modules = {name.rpartition(".")[0] for name in shapes if not name.startswith("text_encoder.")}

    def find(entry: str, is_met: Any) -> str:
        found = [it for it in sorted(modules) if f"{it}.{entry}" in shapes and is_met(shapes[f"{it}.{entry}"])]
        return found[0] if len(found) == 1 else f"(raw-waveform encoder, {entry})"

    for number, channels in enumerate(_WAVEFORM_CHANNELS, 1):
        name = find("weight", lambda shape, channels=channels: len(shape) == 3 and shape[1] == channels)
        yield from _affine(name, f"conv_{number}")
        if number > 1:
            name = find("running_mean", lambda shape, channels=channels: shape == (channels,))
            yield from _norm(name, f"norm_{number - 1}")


def _pose_encoder(*, has_mean: bool) -> Pairs:
    for number in (1, 2, 3):
        yield from _affine(f"net.{number - 1}.0", f"conv_{number}")
        yield from _norm(f"net.{number - 1}.1", f"norm_{number}")
    yield from _affine("net.3", "conv_4")
    for number, place in enumerate((0, 3, 6), 1):
        yield from _affine(f"out_net.{place}", f"linear_{number}")
    for number, place in enumerate((1, 4), 4):
        yield from _norm(f"out_net.{place}", f"norm_{number}")
    if has_mean:
        yield from _affine("fc_mu", "mean")


def _pose_decoder() -> Pairs:
    for number, place in enumerate((0, 3), 1):
        yield from _affine(f"pre_net.{place}", f"linear_{number}")
    yield from _norm("pre_net.1", "norm_1")
    for number, place in enumerate((0, 3), 1):
        yield from _affine(f"net.{place}", f"conv_{number}", TRANSPOSED)
        yield from _norm(f"net.{place + 1}", f"norm_{number + 1}")
    for number, place in enumerate((6, 7), 3):
        yield from _affine(f"net.{place}", f"conv_{number}")
