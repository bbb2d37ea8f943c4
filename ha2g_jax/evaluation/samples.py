"""Write videos of generated motion next to the true motion while a model is trained."""

import pathlib
import sys
from typing import Any

import tqdm

from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.config.settings import Config
from ha2g_jax.data.records import Clip
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.clip_result import clip_identity
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.methods.method import Spec
from ha2g_jax.motion.formats.video import write_video
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import positions_to_directions
from ha2g_jax.synthesis.model import Model, generate_directions

_SECONDS = 10
_SIZE = 360
_SEED = 0


def write_sample(
    folder: pathlib.Path,
    step: int,
    spec: Spec,
    variables: dict[str, Any],
    assets: Assets,
    config: Config,
    clip: Clip,
) -> None:
    """Write the video `folder`/step-00001000.mp4 of ten seconds: true motion on the left, generated on the right.

    The model was trained for `step` steps, and its variables are arrays of this host. The style is that of
    `clip_result.clip_identity`. A sample that cannot be written does not end the run, but is reported on stderr.
    """
    audio = clip.audio[: _SECONDS * SAMPLE_RATE]
    fps, skeleton = config.data.fps, assets.skeleton
    model = Model(spec, variables, assets, config)
    try:
        generated = generate_directions(model, audio, clip_identity(model, clip), _SEED, words=clip.words)
        true = positions_to_directions(skeleton, clip.positions[: _SECONDS * fps])
        motions = {
            "true": Motion.from_directions(skeleton, true, fps),
            f"step {step}": Motion.from_directions(skeleton, generated, fps),
        }
        write_video(folder / f"step-{step:08d}.mp4", motions, audio, SAMPLE_RATE, size=_SIZE, has_progress=False)
    except (UserError, OSError) as error:
        tqdm.tqdm.write(f"no sample of step {step}: {error}", file=sys.stderr)
