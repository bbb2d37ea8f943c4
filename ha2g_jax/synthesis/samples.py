"""Videos of a clip as the model performs it while it is trained, beside the true motion."""

import pathlib
import sys
from typing import Any

import numpy as np
import tqdm

from ha2g_jax.checkpoint.assets import Assets, encode_identity
from ha2g_jax.config import Config
from ha2g_jax.data.records import Clip
from ha2g_jax.data.windows import resize_frames
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.methods.task import Task
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.video import write_video
from ha2g_jax.skeleton import positions_to_directions
from ha2g_jax.synthesis.model import Model, choose_style, generate_directions

_SECONDS = 10
_SIZE = 360
_SEED = 0


def write_sample(
    folder: pathlib.Path,
    step: int,
    task: Task,
    variables: dict[str, Any],
    assets: Assets,
    config: Config,
    clip: Clip,
) -> None:
    """Writes `folder`/step-00001000.mp4: on the left the first ten seconds of a clip, on the right what is generated.

    The style is that of the clip's speaker, else what E_ID sees in the clip's reference frames, else one of the prior.
    A run is worth more than its samples: one that cannot be written is a line on stderr. Call it with the same `task`
    and clip each time, and generation is compiled once.

    Args:
        folder: of the samples; made if there is none.
        step: that the model has had.
        task: whose generator it is.
        variables: of the generator, arrays of this host.
        assets: with the skeleton of the clip; a speaker may have an empty style.
        config: what the model is trained with.
        clip: speech and the true motion.
    """
    audio = clip.audio[: _SECONDS * SAMPLE_RATE]
    fps, skeleton = config.data.fps, assets.skeleton
    model = Model(task, variables, assets, config)
    try:
        generated = generate_directions(model, audio, _style(model, clip), _SEED, words=clip.words)
        true = positions_to_directions(skeleton, clip.positions[: _SECONDS * fps])
        motions = {
            "true": Motion.from_directions(skeleton, true, fps),
            f"step {step}": Motion.from_directions(skeleton, generated, fps),
        }
        write_video(folder / f"step-{step:08d}.mp4", motions, audio, SAMPLE_RATE, size=_SIZE, has_progress=False)
    except (UserError, OSError) as error:
        tqdm.tqdm.write(f"no sample of step {step}: {error}", file=sys.stderr)


def _style(model: Model, clip: Clip) -> np.ndarray:
    """The identity f_id (18,) to perform a clip with."""
    if len(model.assets.speakers.get(clip.speaker, ())):
        return choose_style(model, speaker=clip.speaker)[0]
    if model.task.identity_input == "frames" and clip.reference_frames is not None:
        frames = resize_frames(clip.reference_frames[: model.task.num_reference_frames], model.task.image_size)
        return np.asarray(encode_identity(model.task, model.variables, frames))
    return choose_style(model, style_seed=_SEED)[0]
