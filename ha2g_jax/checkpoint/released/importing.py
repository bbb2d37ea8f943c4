"""Import a released file as a model folder: HA2G, Trimodal, and the pose auto-encoders of the Frechet distance."""

import dataclasses
import os
import pathlib
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from flax import traverse_util

from ha2g_jax.checkpoint import model_folder, weights
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.checkpoint.released import table
from ha2g_jax.checkpoint.released.table import DISCRIMINATOR, FIRST_SPEAKER, FIRST_WORD, SPEAKERS, WORDS, Row
from ha2g_jax.config import presets
from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.files.reading import shown
from ha2g_jax.files.torch_archive import Inert, read_torch
from ha2g_jax.methods import build, discriminator_shapes, generating_method_of, variable_shapes
from ha2g_jax.methods.method import Spec
from ha2g_jax.skeleton import Skeleton, load_skeleton, normalize

_DATA = {27: "ted_gesture", 126: "ted_expressive"}  # by the width of a pose
_OBJECTS = ("args", "lang_model", "speaker_model")  # the parts that may hold objects
_KNOWN = ("epoch", "pose_dim", "latent_dim", *_OBJECTS)
# Entries that are not imported: counters of batches, the linear map of a variance that is never used, and second names
# of the convolutions of a text encoder.
_COUNTERS = re.compile(r"(.*\.)?num_batches_tracked")
_UNUSED = re.compile(r"pose_encoder\.fc_logvar\.(weight|bias)")
_SECOND_NAME = re.compile(r"(.*tcn\.network\.\d+\.)net\.([04])(\..*)")
_FIRST_NAMES = {"0": "conv1", "4": "conv2"}

Parts = Mapping[str, Mapping[str, Any]]


class DoesNotFitError(ValueError):
    """Error for a file whose entries are not those of the table."""


class Released(NamedTuple):
    """The content of a released file, as a model."""

    config: Config
    spec: Spec
    variables: dict[str, Any]
    discriminator: dict[str, Any]  # its variables, {} where the file has none
    assets: Assets
    rows: list[Row]  # of the table that its tensors were found by
    notes: list[str]  # sentences on what was left out, or is not as usual


def import_weights(path: str | os.PathLike, out: str | os.PathLike) -> tuple[pathlib.Path, list[str]]:
    """Write a file of `torch.save` as a model folder, whose weights are float32.

    Returns the folder, and sentences on what was left out or is unusual.

    Raises:
        UserError: the file cannot be read, is not a released file, or does not fit the table; or the folder exists or
            cannot be written.
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
    """Convert the value of a released file, as `read_torch` returns it.

    `size` is that of the networks, a key of `presets.SIZES`; released files have the size of the paper.

    Raises:
        DoesNotFitError: the value is not that of a released file.
    """
    if not isinstance(content, dict):
        kind = content.name if isinstance(content, Inert) else type(content).__name__
        raise DoesNotFitError(f"it holds a {kind} instead of a mapping")
    parts = {str(key): value for key, value in content.items() if _is_part(key, value)}
    data = _data_of(content)
    method, config, rows = _choose(parts, data, size)
    used = {row.part for row in rows}
    _check_names({part: entries for part, entries in parts.items() if part in used}, rows)
    skeleton = load_skeleton(config.skeleton)
    notes = []
    if (mean := _mean_directions(content.get("args"), skeleton.num_bones)) is not None:
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
    flat = _convert(parts, rows, shapes)
    notes += _notes(content, parts, rows, has_discriminator=has_discriminator)
    variables = _nested({name: array for name, array in flat.items() if not _is_of_discriminator(name)})
    discriminator = _nested(
        {name.replace(f"/{DISCRIMINATOR}", "", 1): it for name, it in flat.items() if _is_of_discriminator(name)}
    )
    assets = Assets(skeleton, words, _styles(spec, variables, speakers), _seed_poses(spec, skeleton))
    config.name = f"released_{method}"
    return Released(config, spec, variables, discriminator, assets, rows, notes)


def _is_part(key: Any, value: Any) -> bool:
    return isinstance(key, str) and isinstance(value, dict) and key not in _KNOWN


def _data_of(content: Mapping[Any, Any]) -> str:
    pose_dim = content.get("pose_dim")
    pose_dim = pose_dim.item() if isinstance(pose_dim, np.ndarray) and pose_dim.size == 1 else pose_dim
    if type(pose_dim) is not int or pose_dim not in _DATA:
        raise DoesNotFitError(f"pose_dim is {repr(pose_dim)[:40]}, expected 27 (TED-Gesture) or 126 (TED-Expressive)")
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
    """Return the words and the speakers of the tables; if the file does not have them, invented names and a note."""
    found = []
    for key, conversion, first in (("lang_model", WORDS, FIRST_WORD), ("speaker_model", SPEAKERS, FIRST_SPEAKER)):
        tables = [parts[row.part][row.name].shape for row in rows if row.conversion is conversion]
        if not tables:
            found.append([])
            continue
        if len(tables[0]) != 2 or (count := tables[0][0] - first) < 1:
            raise DoesNotFitError(f"the table of {key} has shape {tables[0]}, expected more than {first} rows")
        made = _names_of(content.get(key), first, count)
        if made is None or len(set(made)) < count:
            notes.append(f"{key} does not name all {count} rows of its table: they are named by their numbers")
            made = [f"<{first + index}>" for index in range(count)]
        found.append(made)
    words, speakers = found
    return Vocabulary(_lower_case(words)), speakers


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
    if rest := _left_out({part: parts[part] for part in used}, rows):
        notes.append(f"{len(rest)} entries have no place: counters, second names and unused variances")
    return notes


def _styles(spec: Spec, variables: dict[str, Any], speakers: list[str]) -> dict[str, np.ndarray]:
    if not spec.identity:
        return {}
    indices = jnp.arange(len(speakers))
    styles = np.asarray(generating_method_of(spec).encode_identity(spec, variables, indices), np.float32)
    return dict(zip(speakers, styles, strict=True))


def _seed_poses(spec: Spec, skeleton: Skeleton) -> np.ndarray:
    """Return the mean pose as the only seed pose, (1, M, bones, 3): released files have no poses."""
    mean = np.asarray(normalize(skeleton.mean_directions), np.float32)
    return np.tile(mean, (1, spec.num_seed_frames, 1, 1))


def _check_names(parts: Parts, rows: Sequence[Row]) -> None:
    """Check that a file has the tensors of the table and no others."""
    missing = [row for row in rows if not isinstance(parts.get(row.part, {}).get(row.name), np.ndarray)]
    if missing:
        more = f" and {len(missing) - 1} more" if missing[1:] else ""
        raise DoesNotFitError(f"no tensor {_shown(missing[0].part, missing[0].name)}{more}")
    odd = [(part, name) for part, name in _left_out(parts, rows) if not _may_be_left_out(parts[part], str(name))]
    if odd:
        more = f" and {len(odd) - 1} more" if odd[1:] else ""
        raise DoesNotFitError(f"{_shown(*odd[0])}{more} is in no row of the table (docs/released_weights.md)")


def _convert(parts: Parts, rows: Sequence[Row], shapes: Mapping[str, tuple[int, ...]]) -> dict[str, np.ndarray]:
    """Convert the tensors of a file whose names were checked to float32 arrays by the names of `shapes`."""
    targets = [row.target for row in rows]
    if len(set(targets)) != len(targets) or set(targets) != set(shapes):
        raise ValueError(f"the table and the networks differ in {sorted(set(targets) ^ set(shapes))[:3]}")
    converted = {}
    for row in rows:
        array, expected = parts[row.part][row.name], row.conversion.stored(shapes[row.target])
        if array.shape != expected:
            raise DoesNotFitError(f"{_shown(row.part, row.name)} has shape {array.shape}, expected {expected}")
        if array.dtype.kind != "f":
            raise DoesNotFitError(f"{_shown(row.part, row.name)} has numbers of type {array.dtype}, expected floats")
        values = _float32(row.conversion.convert(array))
        if not np.isfinite(values).all():
            raise DoesNotFitError(f"{_shown(row.part, row.name)} has values that are not finite")
        converted[row.target] = values
    return converted


def _float32(values: Any) -> np.ndarray:
    """Return numbers as aligned float32, a view of the file where nothing changes; those that are too large as inf."""
    with np.errstate(over="ignore"):
        return np.require(values, np.float32, ("C_CONTIGUOUS", "ALIGNED"))  # not all writers align their numbers


def _left_out(parts: Parts, rows: Iterable[Row]) -> list[tuple[str, str]]:
    """Return (part, name) of the entries that have no row."""
    wanted = {(row.part, row.name) for row in rows}
    return [(part, name) for part, entries in parts.items() for name in entries if (part, name) not in wanted]


def _may_be_left_out(entries: Mapping[str, Any], name: str) -> bool:
    if _COUNTERS.fullmatch(name) or _UNUSED.fullmatch(name):
        return True
    if not (match := _SECOND_NAME.fullmatch(name)):
        return False
    first, second = entries.get(f"{match[1]}{_FIRST_NAMES[match[2]]}{match[3]}"), entries[name]
    return isinstance(first, np.ndarray) and isinstance(second, np.ndarray) and np.array_equal(first, second)


def _shown(part: str, name: Any) -> str:
    return repr(f"{part}: {str(name)[:100]}")


def _names_of(vocabulary: Any, first: int, count: int) -> list[str] | None:
    """Return names by index from an object with a mapping of indices to names, or vice versa; None without one."""
    wanted = range(first, first + count)
    for mapping in _attributes(vocabulary).values():
        if not isinstance(mapping, dict):
            continue
        for names in (mapping, {value: key for key, value in mapping.items() if type(value) is int}):
            found = [names.get(index) for index in wanted]
            if all(isinstance(name, str) for name in found):
                return [str(name) for name in found]
    return None


def _lower_case(words: list[str]) -> tuple[str, ...]:
    """Return words in lower case, as a `Vocabulary` looks for them.

    Of two words that differ only in case, one stays as it is; it is never found but keeps its row.
    """
    taken = set(words)
    made = []
    for word in words:
        lower = word.lower()
        made.append(word if lower in taken else lower)
        taken.add(made[-1])
    return tuple(made)


def _mean_directions(settings: Any, num_bones: int) -> np.ndarray | None:
    """Return the mean direction vectors (bones, 3) of the settings, a list of 3 * bones numbers, or of lists of one."""
    for values in _attributes(settings).values():
        if not isinstance(values, list) or len(values) != 3 * num_bones:
            continue
        flat = [value[0] if isinstance(value, list) and len(value) == 1 else value for value in values]
        if all(isinstance(value, float) for value in flat) and np.isfinite(mean := _float32(flat)).all():
            return mean.reshape(num_bones, 3)
    return None


def _attributes(value: Any) -> dict[Any, Any]:
    state = value.state if isinstance(value, Inert) else value
    return state if isinstance(state, dict) else {}
