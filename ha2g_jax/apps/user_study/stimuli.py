"""The videos of a study: one figure, one camera and one length for all that is compared with each other."""

import itertools
import pathlib
from collections.abc import Sequence

import numpy as np

from ha2g_jax.apps.user_study.design import Planned, Scene
from ha2g_jax.apps.user_study.key import ATTENTION
from ha2g_jax.apps.user_study.sources import Sources
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.espeak import Voice, say
from ha2g_jax.motion.formats.video import fit_view, write_video
from ha2g_jax.motion.motion import Motion
from ha2g_jax.progress import progress_bar

_VOICE = Voice("en-us", "f2", pitch=50, pitch_range=50, rate=140)
_NUMBERS = ("zero", "one", "two", "three", "four", "five")
_BAND = 0.15  # metres above the figure for what is written in a check
_SILENCE = 0.5  # seconds before and after the words of a check


def render(stimuli: Sequence[Planned], sources: Sources, folder: pathlib.Path, *, size: int = 480) -> None:
    """Write the video of each stimulus as `ID.mp4`.

    Args:
        stimuli: stimuli, in any order.
        sources: motion and sound.
        folder: folder to write to.
        size: side of the square picture in pixels, even.

    Raises:
        UserError: the size is out of range, espeak-ng cannot be loaded, or a file cannot be written.
    """

    def scene_of(stimulus: Planned) -> tuple[str, str, int]:
        return stimulus.scene.part, stimulus.scene.clip, stimulus.scene.number or 0

    # Within a scene in the order of the random ids, so that the times of the files do not tell the system.
    ordered = sorted(stimuli, key=lambda stimulus: (scene_of(stimulus), stimulus.id))
    with progress_bar("rendering", len(stimuli), "video") as bar:
        for _, together in itertools.groupby(ordered, key=scene_of):
            compared = list(together)
            motions = [sources.motions[stimulus.system][stimulus.clip] for stimulus in compared]
            sound, text = _sound(compared[0].scene, motions, sources), _text(compared[0].scene)
            view = fit_view(motions, len(sound) / SAMPLE_RATE)
            view = view._replace(top=view.top - _BAND) if text else view
            for stimulus, motion in zip(compared, motions, strict=True):
                path = folder / f"{stimulus.id}.mp4"
                write_video(path, {text: motion}, sound, size=size, view=view, has_progress=False)
                bar.update()


def _sound(scene: Scene, motions: Sequence[Motion], sources: Sources) -> np.ndarray:
    """Return the sound of a scene, as long as every motion in it lasts."""
    if scene.number is not None:
        words = say(f"This is a check. Please choose the number {_NUMBERS[scene.number]}.", _VOICE).audio
        return np.pad(words, round(_SILENCE * SAMPLE_RATE))
    seconds = min(sources.durations[scene.clip], *(motion.num_frames / motion.fps for motion in motions))
    return sources.sounds[scene.clip][: round(seconds * SAMPLE_RATE)]


def _text(scene: Scene) -> str:
    """Return what is written above the figure, which is nothing but in a check."""
    return f"Please choose {scene.number}" if scene.part == ATTENTION else ""
