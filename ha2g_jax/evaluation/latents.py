"""What an evaluation says of the pose auto-encoder and of the windows that it encodes."""

from typing import TYPE_CHECKING, Any

from ha2g_jax import metrics
from ha2g_jax.data.records import WINDOW_FRAMES
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.intervals import number
from ha2g_jax.metrics.frechet import SAMPLES_PER_DIMENSION, is_too_few
from ha2g_jax.metrics.row import FGD_SEEDED_CUT, Row, cut_windows, reference_cut, row_latents
from ha2g_jax.metrics.sanity import HALF
from ha2g_jax.skeleton import Skeleton

if TYPE_CHECKING:
    from ha2g_jax.evaluation.features import PoseFeatures

NO_AUTOENCODER = (
    "no FGD and no diversity without a pose auto-encoder; train one with "
    "`ha2g train --config autoencoder:DATA --workdir WORKDIR` and give --autoencoder WORKDIR"
)

_BIAS = (
    "a distance of resampled recordings is greater on average than that of all, so that its interval may lie above it; "
    f"compare the distance of a row with that of the row {HALF}"
)


def check_autoencoder(autoencoder: "PoseFeatures | None", skeleton: Skeleton, fps: float) -> None:
    """Refuse an auto-encoder of other motion.

    Raises:
        UserError: the auto-encoder is of another skeleton or frame rate.
    """
    if autoencoder is not None and (autoencoder.skeleton.name, autoencoder.fps) != (skeleton.name, fps):
        raise UserError(
            f"the pose auto-encoder is of the skeleton {autoencoder.skeleton.name} at {autoencoder.fps:g} frames per "
            f"second, the motion of {skeleton.name} at {fps:g}; give one that was trained on such motion"
        )


def count_windows(truth: Row) -> int | None:
    """Return the number of windows of ground truth, None without latents."""
    found = truth.once(row_latents)
    return None if found is None else len(found.latents)


def describe(truth: Row, autoencoder: "PoseFeatures | None") -> dict[str, Any] | None:
    """Return what the latents are of, for the results; None without latents."""
    found = truth.once(row_latents)
    windows = None if found is None else cut_windows(truth, found.cut)
    if autoencoder is None or windows is None:
        return None
    return {
        "id": autoencoder.id,
        "name": autoencoder.name,
        "data": autoencoder.data,
        "latent_dim": autoencoder.latent_dim,
        "fps": autoencoder.fps,
        "window": WINDOW_FRAMES,
        "reconstruction_error": number(autoencoder.reconstruction_error(windows)),
    }


def warnings(truth: Row, autoencoder: "PoseFeatures | None") -> list[str]:
    """Return sentences on distances that are not reliable."""
    found = truth.once(row_latents)
    if autoencoder is None or found is None:
        return []
    sentences, count, latent_dim = [], len(found.latents), autoencoder.latent_dim
    if is_too_few(count, latent_dim):
        sentences.append(
            f"{count} windows for {latent_dim} latent values, less than {SAMPLES_PER_DIMENSION} times as many: the FGD "
            f"says more about their number than about the motion; compare it with the row {HALF}"
        )
    if found.cut.name == FGD_SEEDED_CUT:
        title = metrics.lookup("fgd_seeded").title
        sentences.append(f"clips are too short to leave the seed pose out of a window, so the distance is {title}")
    return sentences


def notes(truth: Row, autoencoder: "PoseFeatures | None") -> list[str]:
    """Return sentences on what has no latents."""
    cut = truth.reference.once(reference_cut)
    if autoencoder is None:
        return [NO_AUTOENCODER]
    if cut is None:
        return [f"no clip has {WINDOW_FRAMES} frames, so no FGD and no diversity"]
    short = sum(not cut.starts(len(directions)) for directions in truth.directions)
    return [_BIAS] + ([f"{short} clips are shorter than a window and not part of FGD and diversity"] if short else [])
