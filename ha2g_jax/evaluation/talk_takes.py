"""Sample takes of a model and of the teacher of the Talk corpus for the same speech, for the metrics of takes."""

import functools
from collections.abc import Sequence

import numpy as np
from tqdm import tqdm

from ha2g_jax.data.records import Clip
from ha2g_jax.data.talk import teacher
from ha2g_jax.data.talk.speakers import Style
from ha2g_jax.evaluation.clip_result import clip_identity, generate_clip, in_threads
from ha2g_jax.metrics.beats.strokes import wrist_positions
from ha2g_jax.metrics.sanity import MEAN_POSE
from ha2g_jax.metrics.takes import TakeDistances, take_distances
from ha2g_jax.skeleton import Skeleton, positions_to_directions
from ha2g_jax.synthesis import Model
from ha2g_jax.synthesis.style import later_seed

MODEL, TEACHER, ONE_TAKE = "model", "teacher", "teacher, one take"
MAX_CLIPS = 8  # clips of a split
TEACHER_TAKES, MODEL_TAKES = 20, 8


def compare_takes(
    model: Model, clips: Sequence[Clip], seed: int, look_ahead: int | None, progress: tqdm
) -> dict[str, list[TakeDistances]]:
    """Compare sets of takes with those of the teacher, by the wrists, for each clip.

    The sets are the model's with other seeds, other takes of the teacher (the floor), one of them repeated, and the
    mean pose. All have the speech, words and style of the clip.

    Returns:
        Name of each set -> distances of each clip.
    """
    skeleton, found = model.spec.skeleton, {}
    for index, clip in enumerate(clips):
        style = clip_identity(model, clip)
        taught = [teach(skeleton, clip, [seed, index, take], model.fps) for take in range(TEACHER_TAKES)]
        generate = functools.partial(generate_clip, model, clip, style, look_ahead=look_ahead)
        made = list(in_threads(generate, [later_seed(seed, take) for take in range(MODEL_TAKES)]))
        scored = slice(model.spec.num_seed_frames, min(map(len, (*taught, *made))))
        true, own = (np.stack([wrist_positions(skeleton, take[scored]) for take in takes]) for takes in (taught, made))
        still = np.broadcast_to(wrist_positions(skeleton, skeleton.mean_directions[None]), own[:1].shape)
        for name, takes, others in (
            (MODEL, own, true),
            (TEACHER, true[:MODEL_TAKES], true[MODEL_TAKES:]),
            (ONE_TAKE, true[:1], true[1:]),
            (MEAN_POSE, still, true),
        ):
            found.setdefault(name, []).append(take_distances(takes, others))
        progress.update()
    return found


def teach(skeleton: Skeleton, clip: Clip, seed: list[int], fps: float) -> np.ndarray:
    """Return the directions (T, bones, 3) of a take of the teacher, which rests while nobody speaks."""
    heard = clip.audio if clip.words else np.zeros_like(clip.audio)
    taught = teacher.perform(heard, clip.words, Style(*clip.style), np.random.default_rng(seed), fps)
    return positions_to_directions(skeleton, taught.positions)
