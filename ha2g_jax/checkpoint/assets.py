"""Assets of a trained model other than its weights: skeleton, vocabulary, styles of its speakers, seed poses."""

import dataclasses
import reprlib
from typing import Any

import numpy as np

from ha2g_jax.features.text import Vocabulary
from ha2g_jax.limits import MAX_SEED_POSES
from ha2g_jax.skeleton import SKELETONS, Skeleton, load_skeleton

SCHEMA_VERSION = 1

_MAX_HASH_LENGTH = 64
STATISTICS = ("lengths", "mean_directions", "mean_pose", "angle_mean", "angle_variance", "angle_change")


@dataclasses.dataclass(frozen=True)
class Assets:
    """Assets of a trained model; skeleton and words are those of the training split."""

    skeleton: Skeleton
    vocabulary: Vocabulary
    speakers: dict[str, np.ndarray]  # name -> (style_dim,) float32 style, in the order of the speakers' indices
    seed_poses: np.ndarray  # (K, M, bones, 3) float32 unit vectors, calm poses that generation starts from
    hash: str = ""  # of the weights, "" before training

    def choose_seed_pose(self, seed: int) -> int:
        """Return the index of the seed pose that generation with a seed starts from."""
        return int(np.random.default_rng(seed).integers(len(self.seed_poses)))

    def __repr__(self) -> str:
        counts = f"{len(self.vocabulary.words)} words, {len(self.speakers)} speakers, {len(self.seed_poses)} seed poses"
        return f"Assets({self.skeleton.name}, {counts}, hash {self.hash or 'none'})"


def to_json(assets: Assets) -> dict[str, Any]:
    """Return assets as plain values, from which `from_json` restores them exactly."""
    return {
        "schema_version": SCHEMA_VERSION,
        "skeleton": {"name": assets.skeleton.name}
        | {name: shortest_decimals(getattr(assets.skeleton, name)) for name in STATISTICS},
        "vocabulary": list(assets.vocabulary.words),
        "speakers": {name: shortest_decimals(f_id) for name, f_id in assets.speakers.items()},
        "seed_poses": shortest_decimals(assets.seed_poses),
        "hash": assets.hash,
    }


def from_json(values: Any) -> Assets:
    """Return the assets that `to_json` wrote.

    Raises:
        KeyError, TypeError, ValueError, OverflowError: the values are not assets.
    """
    if not isinstance(values, dict):
        raise TypeError("not an object of JSON")
    if values["schema_version"] != SCHEMA_VERSION:
        raise ValueError(f"schema version {reprlib.repr(values['schema_version'])} instead of {SCHEMA_VERSION}")
    if values["skeleton"]["name"] not in SKELETONS:
        raise ValueError(f"unknown skeleton {reprlib.repr(values['skeleton']['name'])}")
    skeleton = load_skeleton(values["skeleton"]["name"])
    statistics: dict[str, Any] = {}
    for name in STATISTICS:
        statistics[name] = _array(values["skeleton"][name], name)
        if statistics[name].shape != getattr(skeleton, name).shape:
            raise ValueError(f"{name} has shape {statistics[name].shape} instead of {getattr(skeleton, name).shape}")
    seed_poses = _array(values["seed_poses"], "seed_poses")
    if seed_poses.ndim != 4 or not len(seed_poses) or seed_poses.shape[2:] != (skeleton.num_bones, 3):
        raise ValueError(f"seed_poses has shape {seed_poses.shape} instead of (K, M, {skeleton.num_bones}, 3)")
    if len(seed_poses) > MAX_SEED_POSES:
        raise ValueError(f"{len(seed_poses)} seed poses instead of at most {MAX_SEED_POSES}")
    words, speakers, found = values["vocabulary"], values["speakers"], values["hash"]
    if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
        raise ValueError("the vocabulary is not a list of words")
    if not isinstance(speakers, dict):
        raise TypeError("the speakers are not an object of names")
    if not isinstance(found, str) or len(found) > _MAX_HASH_LENGTH or not found.isprintable():
        raise ValueError("the hash is not a hexadecimal number")
    return Assets(
        skeleton=dataclasses.replace(skeleton, **statistics),
        vocabulary=Vocabulary(tuple(words)),
        speakers={name: _array(f_id, "a style") for name, f_id in speakers.items()},
        seed_poses=seed_poses,
        hash=found,
    )


def check_fit(assets: Assets, num_seed_frames: int, style_dim: int) -> None:
    """Check that seed poses and styles have the sizes of the networks.

    Raises:
        ValueError: a size differs.
    """
    if assets.seed_poses.shape[1] != num_seed_frames:
        raise ValueError(f"seed poses of {assets.seed_poses.shape[1]} frames instead of {num_seed_frames}")
    for name, f_id in assets.speakers.items():
        if f_id.shape != (style_dim,):
            raise ValueError(f"the style of {name[:50]!r} has shape {f_id.shape} instead of ({style_dim},)")


def _array(values: Any, name: str) -> np.ndarray:
    """Return nested lists of finite numbers as float32."""
    with np.errstate(over="ignore"):
        array = np.asarray(values, np.float32)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} has values that are not finite")
    return array


def shortest_decimals(array: np.ndarray) -> Any:
    """Return nested lists of the shortest decimals that give the same float32."""
    array = np.asarray(array, np.float32)
    return [shortest_decimals(row) for row in array] if array.ndim else float(str(array))
