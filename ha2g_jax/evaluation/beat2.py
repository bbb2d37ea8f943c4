"""Folders of SMPL-X motion scored as the papers on BEAT2 do, with intervals and paired differences."""

import itertools
import os
import pathlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.evaluate import measure
from ha2g_jax.evaluation.intervals import DRAWS, Intervals
from ha2g_jax.evaluation.motion_folders import Folders
from ha2g_jax.files.reading import shown
from ha2g_jax.metrics import sanity
from ha2g_jax.metrics.beats import rests
from ha2g_jax.metrics.beats.rests import EDGE, FPS, UPPER_BODY, Beat2Row
from ha2g_jax.metrics.metric import Statistic
from ha2g_jax.metrics.sanity import MISMATCHED, TRUTH
from ha2g_jax.motion.readers import read_content, smplx, smplx_arrays
from ha2g_jax.motion.readers.smplx_body import JOINTS, Body, read_body_model, template

PROTOCOL = "beat2"

_UPPER = [JOINTS.index(name) for name in UPPER_BODY]


class _Files(NamedTuple):
    """Files of one method and of the reference, in the same order."""

    motion: list[pathlib.Path]
    reference: list[pathlib.Path]


def score_beat2(
    read: Mapping[str, Folders],
    *,
    body_model: str | os.PathLike | None = None,
    source_fps: float | None = None,
    seed: int = 0,
    draws: int = DRAWS,
) -> dict[str, Any]:
    """Score folders of SMPL-X motion by BC and L1div of BEAT2.

    A sequence is as long as the shortest of its motions and its reference. Shapes are those of the reference. Of
    several motions for one sequence the first is scored.

    Args:
        read: what `motion_folders.from_folders` read, by the name of the method.
        body_model: path of an SMPL-X body model (.npz), as the papers use; None for the neutral template.
        source_fps: frames per second of files that do not say it.
        seed: seed of the bootstrap and of the pairs of mismatched speech.
        draws: number of draws of the bootstrap.

    Returns:
        {"rows": {row: {metric: {"value", "low", "high"}}}, "notes"}; rows are the methods, their paired differences
        from the first, ground truth and mismatched speech.

    Raises:
        UserError: a file is no SMPL-X motion, or no sequence is left.
    """
    body = template() if body_model is None else read_body_model(body_model)
    methods = {name: {clip.id: clip.path for clip in reversed(each.motion)} for name, each in read.items()}
    truth = {clip.id: clip for each in read.values() for clip in each.reference}
    ids = [name for name in truth if all(name in paths for paths in methods.values())]
    if not ids:
        raise UserError("no sequence has motion by all methods; give motion of the same clips as the reference")
    joints: dict[str, list[np.ndarray]] = {name: [] for name in (TRUTH, *methods)}
    for clip in ids:
        arrays = _read(truth[clip].path, source_fps)
        found = {TRUTH: _joints(arrays, body, arrays.betas)}
        for name, paths in methods.items():
            found[name] = _joints(_read(paths[clip], source_fps), body, arrays.betas)
        length = min(map(len, found.values()))
        for name, places in found.items():
            joints[name].append(places[:length])
    recordings, members = np.unique([truth[clip].recording for clip in ids], return_inverse=True)
    speeds = rests.mean_speeds([places[:, _UPPER] for places in joints[TRUTH]], FPS, first_frame=0)
    onsets = [truth[clip].onsets for clip in ids]
    rows = {name: Beat2Row(places, onsets, speeds, _UPPER, members, len(recordings)) for name, places in joints.items()}
    if len(recordings) > 1:
        others = sanity.derangement(
            [str(member) for member in members], np.random.default_rng(seed), lengths=[len(it) for it in joints[TRUTH]]
        )
        mismatched = [onsets[other] for other in others.tolist()]
        rows[MISMATCHED] = Beat2Row(joints[TRUTH], mismatched, speeds, _UPPER, members, len(recordings))
    intervals = Intervals(len(recordings), draws, seed)
    scores = {name: measure(row, "beat2") for name, row in rows.items()}
    results = {name: {key: intervals(score) for key, score in scores[name].items()} for name in (*methods, TRUTH)}
    results |= {name: {key: intervals(it) for key, it in scores[name].items()} for name in rows if name not in results}
    for first, other in itertools.product(list(methods)[:1], list(methods)[1:]):
        results[f"{other} - {first}"] = {
            key: intervals.of_statistic(_difference(scores[other][key], scores[first][key])) for key in scores[first]
        }
    return {"rows": results, "notes": _notes(body_model, len(ids))}


def _read(path: pathlib.Path | None, source_fps: float | None) -> smplx_arrays.SmplxArrays:
    if path is None:
        raise UserError("the protocol beat2 needs files of SMPL-X motion")
    content = read_content(path)
    try:
        return smplx_arrays.to_arrays(content.arrays, source_fps)
    except UserError as error:
        raise UserError(f"{shown(path)}: {error}; the protocol beat2 scores SMPL-X only") from error


def _joints(arrays: smplx_arrays.SmplxArrays, body: Body, betas: np.ndarray) -> np.ndarray:
    """Return (T, 55, 3) metres of all joints at 30 frames per second, the pelvis where it is at rest."""
    return smplx.joints_at_origin(arrays, body.shaped(betas), FPS)


def _difference(first: Any, second: Any) -> Statistic:
    return lambda counts: first(counts) - second(counts)


def _notes(body_model: str | os.PathLike | None, count: int) -> list[str]:
    body = "the body model that was given" if body_model is not None else "the neutral template, not the body model"
    return [
        f"{count} sequences at {FPS:g} frames per second; joints of {body} (--body-model)",
        f"BC without the first and last {EDGE / FPS:g} s; speeds relative to the mean of the reference; not times 10",
        "FGD is above, of --autoencoder: published FGDs are of the authors' auto-encoder and cannot be compared",
    ]
