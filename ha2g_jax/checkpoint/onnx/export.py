"""Writer of a generator as an ONNX file."""

import dataclasses
import pathlib

import onnx

from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint.model_folder import LoadedModel
from ha2g_jax.checkpoint.onnx.networks import Graph, add_encoder, add_inferer
from ha2g_jax.checkpoint.onnx.reading import MAX_TEXT, SUFFIX, Description, input_names, parse, to_metadata
from ha2g_jax.errors import UserError
from ha2g_jax.features.spectrum import NUM_MELS, window_columns
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.files.reading import shown
from ha2g_jax.files.writing import whole_file
from ha2g_jax.layers.resnet_se import AudioEncoder
from ha2g_jax.limits import MAX_ONNX_BYTES
from ha2g_jax.methods.ha2g.model import HA2G


def export(
    source: str | pathlib.Path, out: str | pathlib.Path, *, weights: str = "float32", license: str = ""
) -> pathlib.Path:
    """Write a model atomically as an ONNX file, whose suffix is .onnx, and return its path.

    Large weights have the form `weights`, one of `networks.WEIGHTS`; the computation is float32. The licence of the
    model is stored in the file; that of the demo is known.

    Raises:
        UserError: there is no model, it is not HA2G with the audio encoder of the paper, the licence is no short line,
            or the file cannot be written.
    """
    out = pathlib.Path(out)
    if out.suffix.lower() != SUFFIX:
        raise UserError(f"an ONNX file ends in {SUFFIX}; name it {shown(out.stem or 'model')}{SUFFIX}")
    if len(license) > MAX_TEXT or not license.isprintable():
        raise UserError(
            f"the licence '{shown(license)}' is too long or cannot be printed; give at most {MAX_TEXT} characters of "
            "one line, such as Apache-2.0"
        )
    loaded = model_folder.load(source)
    if len(name := loaded.config.name) > MAX_TEXT or not name.isprintable():
        raise UserError(
            f"the name of the model '{shown(name)}' is too long or cannot be printed; change name in its config.json "
            f"to at most {MAX_TEXT} characters of one line"
        )
    model = build(loaded, weights=weights, license=license or ("Apache-2.0" if source == "demo" else ""))
    content = model.SerializeToString()
    try:
        parse(content)
    except ValueError as error:
        advice = "train one of fewer channels or shorter windows"
        raise UserError(f"the model is too large for an ONNX file ({error}); {advice}") from error
    if len(content) > MAX_ONNX_BYTES:
        raise UserError(
            f"the file would have {len(content)} bytes, expected at most {MAX_ONNX_BYTES}; use --weights float16"
        )
    with whole_file(out) as temporary:
        temporary.write_bytes(content)
    return out


def build(loaded: LoadedModel, *, weights: str = "float32", license: str = "") -> onnx.ModelProto:
    """Return a model as one graph of ONNX.

    Its inputs are "mel" (B, 128, columns) in dB, "style" (B, style_dim), "seed_pose" (B, M, bones, 3), unit vectors,
    and, for a model with noise, "noise" (B, N, noise_dim). Its output is "poses" (B, N, bones, 3), unit vectors, those
    of `synthesis.scan.generate_window`.

    Raises:
        UserError: the model is of another method, or has another audio encoder.
    """
    spec, generator = loaded.spec, loaded.spec.generator
    if spec.method not in ("ha2g", "energy_ha2g"):
        raise UserError(f"the model is of {spec.method}; only HA2G can be exported to ONNX")
    if not isinstance(generator, HA2G):
        raise UserError(
            "the model has the networks of the public code; only those of the paper can be exported to ONNX"
        )
    if not isinstance(generator.audio, AudioEncoder):
        kind = loaded.config.model.audio.kind
        raise UserError(f"the audio encoder of the model is {kind}; only resnet_se can be exported to ONNX")
    if generator.reads_words or not generator.has_coordinator:
        raise UserError("the model is a control of HA2G (oracle, no coordinator), which cannot be exported to ONNX")
    graph = Graph(weights)
    params, stats = loaded.variables["params"], loaded.variables["batch_stats"]
    features = add_encoder(graph, generator.audio, params["audio"], stats["audio"], "mel")
    poses = add_inferer(graph, generator, spec.skeleton, params, features, "style", "seed_pose", "noise")
    bones, size = spec.skeleton.num_bones, generator.audio.feature_dim
    description = Description(
        name=loaded.config.name,
        method=spec.method,
        num_frames=spec.num_frames,
        num_seed_frames=spec.num_seed_frames,
        fps=spec.fps,
        style_dim=spec.style_dim,
        has_hidden_ends=loaded.config.data.get("lookahead", 0.0) > 0,
        weights=weights,
        license=license,
        assets=dataclasses.replace(loaded.assets, vocabulary=Vocabulary(())),
        noise_dim=spec.noise_dim,
    )
    inputs = {
        "mel": ("batch", NUM_MELS, window_columns(spec.num_frames, spec.fps)),
        "style": ("batch", spec.style_dim),
        "seed_pose": ("batch", spec.num_seed_frames, bones, 3),
        "noise": ("batch", spec.num_frames, spec.noise_dim),
    }
    return graph.model(
        inputs={name: inputs[name] for name in input_names(description)},
        outputs={poses: ("batch", spec.num_frames, bones, 3)},
        inner=dict.fromkeys(features, ("batch", spec.num_frames, size)),
        metadata=to_metadata(description),
    )
