"""Import a released file as a model folder: HA2G, Trimodal, and the pose auto-encoders of the Frechet distance."""

import dataclasses
import os
import pathlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from flax import traverse_util

from ha2g_jax.checkpoint import model_folder, weights
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.checkpoint.released import names, table
from ha2g_jax.checkpoint.released.conversions import FIRST_SPEAKER, FIRST_WORD, SPEAKERS, WORDS
from ha2g_jax.checkpoint.released.mapping import DoesNotFitError, check_names, convert, left_out
from ha2g_jax.checkpoint.released.table import DISCRIMINATOR, Row
from ha2g_jax.config import presets
from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.files.reading import shown
from ha2g_jax.files.torch_archive import Inert, read_torch
from ha2g_jax.methods.build import build, discriminator_shapes, generating_method_of, variable_shapes
from ha2g_jax.methods.method import Spec
from ha2g_jax.skeleton import Skeleton, load_skeleton, normalize

_DATA = {27: "ted_gesture", 126: "ted_expressive"}  # by the width of a pose
_OBJECTS = ("args", "lang_model", "speaker_model")  # the parts that may hold objects
_KNOWN = ("epoch", "pose_dim", "latent_dim", *_OBJECTS)


class Released(NamedTuple):
    """What a released file holds, as a model.

    Attributes:
        config: settings of the networks.
        spec: the networks.
        variables: {"params", "batch_stats"} of the generator.
        discriminator: those of the discriminator, {} where the file has none.
        assets: skeleton, vocabulary, styles of the speakers and the start pose.
        rows: rows of the table that its tensors were found by.
        notes: sentences on what was left out, or is not as usual.
    """

    config: Config
    spec: Spec
    variables: dict[str, Any]
    discriminator: dict[str, Any]
    assets: Assets
    rows: list[Row]
    notes: list[str]


def import_weights(path: str | os.PathLike, out: str | os.PathLike) -> tuple[pathlib.Path, list[str]]:
    """Write a released file as a model folder, whose weights are float32.

    Args:
        path: file of `torch.save`.
        out: folder to write, which does not exist or is empty.

    Returns:
        The folder, and sentences on what was left out, or is not as usual.

    Raises:
        UserError: the file cannot be read, is none that was released, or does not fit the table; or the folder exists
            or cannot be written.
    """
    try:
        found = read_released(read_torch(path))
    except DoesNotFitError as error:
        raise UserError(
            f"{shown(path)} is not a released file as docs/released_weights.md describes: {error}"
        ) from error
    folder = model_folder.save(pathlib.Path(out), found.config, found.assets, found.variables, is_exact=True)
    return folder, found.notes


def read_released(content: Any, size: str = "") -> Released:
    """Convert the value of a released file.

    Args:
        content: value of `read_torch`.
        size: size of the networks, a key of `config.SIZES`; that of the paper for released files.

    Raises:
        DoesNotFitError: the value is none of a released file.
    """
    if not isinstance(content, dict):
        kind = content.name if isinstance(content, Inert) else type(content).__name__
        raise DoesNotFitError(f"it holds a {kind} instead of a mapping")
    parts = {str(key): value for key, value in content.items() if _is_part(key, value)}
    data = _data_of(content)
    method, config, rows = _choose(parts, data, size)
    used = {row.part for row in rows}
    check_names({part: entries for part, entries in parts.items() if part in used}, rows)
    skeleton = load_skeleton(config.skeleton)
    notes = []
    if (mean := names.mean_directions(content.get("args"), skeleton.num_bones)) is not None:
        skeleton = dataclasses.replace(skeleton, mean_directions=mean)
    else:
        notes.append(f"the settings have no mean directions: those of {skeleton.name} are used")
    words, speakers = _names(content, parts, rows, notes)
    try:
        spec = build(config, skeleton, len(words), len(speakers))
    except UserError as error:
        raise DoesNotFitError(str(error)) from error
    shapes = _shapes("", variable_shapes(spec))
    if has_discriminator := any(row.part == "dis_dict" for row in rows):
        shapes |= _shapes(DISCRIMINATOR, discriminator_shapes(spec))
    flat = convert(parts, rows, shapes)
    notes += _notes(content, parts, rows, has_discriminator=has_discriminator)
    variables = _nested({name: array for name, array in flat.items() if not _is_of_discriminator(name)})
    discriminator = _nested(
        {name.replace(f"/{DISCRIMINATOR}", "", 1): it for name, it in flat.items() if _is_of_discriminator(name)}
    )
    assets = Assets(skeleton, words, _styles(spec, variables, speakers), _start_poses(spec, skeleton))
    config.name = f"released_{method}"
    return Released(config, spec, variables, discriminator, assets, rows, notes)


def _is_part(key: Any, value: Any) -> bool:
    return isinstance(key, str) and isinstance(value, dict) and key not in _KNOWN


def _data_of(content: Mapping[Any, Any]) -> str:
    pose_dim = content.get("pose_dim")
    pose_dim = pose_dim.item() if isinstance(pose_dim, np.ndarray) and pose_dim.size == 1 else pose_dim
    if type(pose_dim) is not int or pose_dim not in _DATA:
        raise DoesNotFitError(f"pose_dim is {str(pose_dim)[:40]}, expected 27 (TED-Gesture) or 126 (TED-Expressive)")
    return _DATA[pose_dim]


def _choose(parts: Mapping[str, Mapping[str, Any]], data: str, size: str) -> tuple[str, Config, list[Row]]:
    """Return the name of the method, its config and the rows of the table."""
    generator = [str(name) for name in parts.get("gen_dict", {})]
    released = {"model.architecture": "release"}
    if "motion_ae" in parts or any(name.startswith("pose_encoder.") for name in generator):
        expected, part, encoder = (
            ("ted_expressive", "motion_ae", "encoder")
            if "motion_ae" in parts
            else ("ted_gesture", "gen_dict", "pose_encoder")
        )
        if data != expected:
            raise DoesNotFitError(f"an auto-encoder in {part} is one of {expected}, but pose_dim is of {data}")
        config = presets.make(data, size, "autoencoder", released)
        return "autoencoder", config, table.autoencoder(part, encoder, has_mean=data == "ted_gesture")
    if "gen_dict_1" in parts:
        config = presets.make(data, size, "release")
        rows = table.ha2g(config, load_skeleton(data).num_levels)
        return "ha2g", config, _without_absent_discriminator(rows, parts)
    if generator:
        config = presets.make(data, size, "trimodal", released)
        return "trimodal", config, _without_absent_discriminator(table.trimodal(config, parts["gen_dict"]), parts)
    raise DoesNotFitError(
        f"it has {', '.join(sorted(parts))[:100] or 'no weights'}, expected gen_dict_1, gen_dict or motion_ae"
    )


def _without_absent_discriminator(rows: list[Row], parts: Mapping[str, Any]) -> list[Row]:
    return [row for row in rows if row.part in parts or row.part != "dis_dict"]


def _names(
    content: Mapping[Any, Any], parts: Mapping[str, Mapping[str, Any]], rows: list[Row], notes: list[str]
) -> tuple[Vocabulary, list[str]]:
    """Return the words and the speakers of the tables; made-up names, and a note, where the file does not have them."""
    found = []
    for key, conversion, first in (("lang_model", WORDS, FIRST_WORD), ("speaker_model", SPEAKERS, FIRST_SPEAKER)):
        tables = [parts[row.part][row.name].shape for row in rows if row.conversion is conversion]
        if not tables:
            found.append([])
            continue
        if len(tables[0]) != 2 or (count := tables[0][0] - first) < 1:
            raise DoesNotFitError(f"the table of {key} has shape {tables[0]}, expected more than {first} rows")
        made = names.names_of(content.get(key), first, count)
        if made is None or len(set(made)) < count:
            notes.append(f"{key} does not name all {count} rows of its table: they are named by their numbers")
            made = [f"<{first + index}>" for index in range(count)]
        found.append(made)
    words, speakers = found
    return Vocabulary(names.lower_case(words)), speakers


def _shapes(module: str, tree: Any) -> dict[str, tuple[int, ...]]:
    flat = {}
    for name, leaf in weights.flatten(tree).items():
        collection, _, path = name.partition("/")
        flat["/".join(filter(None, (collection, module, path)))] = leaf.shape
    return flat


def _is_of_discriminator(name: str) -> bool:
    return name.split("/")[1] == DISCRIMINATOR


def _nested(flat: dict[str, np.ndarray]) -> dict[str, Any]:
    return {"params": {}, "batch_stats": {}} | traverse_util.unflatten_dict(flat, sep="/") if flat else {}


def _notes(
    content: Mapping[Any, Any],
    parts: Mapping[str, Mapping[str, Any]],
    rows: list[Row],
    *,
    has_discriminator: bool,
) -> list[str]:
    notes, used = [], {row.part for row in rows}
    if has_discriminator:
        count = sum(row.part == "dis_dict" for row in rows)
        notes.append(f"the {count} tensors of dis_dict fit, and are left out: a model folder has no discriminator")
    if unread := sorted(str(key)[:40] for key in content if key not in used and key not in _KNOWN):
        notes.append(f"not read: {', '.join(unread)[:200]}")
    if rest := left_out({part: parts[part] for part in used}, rows):
        notes.append(f"{len(rest)} entries have no place: counters, second names and unused variances")
    return notes


def _styles(spec: Spec, variables: dict[str, Any], speakers: list[str]) -> dict[str, np.ndarray]:
    if not spec.identity:
        return {}
    indices = jnp.arange(len(speakers))
    styles = np.asarray(generating_method_of(spec).encode_identity(spec, variables, indices), np.float32)
    return dict(zip(speakers, styles, strict=True))


def _start_poses(spec: Spec, skeleton: Skeleton) -> np.ndarray:
    """Return the mean pose as the only start pose, (1, M, bones, 3): released files have no poses."""
    mean = np.asarray(normalize(skeleton.mean_directions), np.float32)
    return np.tile(mean, (1, spec.num_seed_frames, 1, 1))
