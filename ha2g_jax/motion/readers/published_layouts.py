"""Layouts of Seamless Interaction and Embody 3D, brought to the names and units of `smplx_arrays`.

Seamless Interaction has a file of SMPL-H for each person of a conversation, beside its audio and its transcript:

    V00_S0809_I00000582_P0947.npz    smplh:global_orient (T, 3), smplh:body_pose (T, 21, 3), smplh:left_hand_pose and
                                     smplh:right_hand_pose (T, 15, 3), smplh:translation (T, 3) in cm, smplh:is_valid
    V00_S0809_I00000582_P0947.wav    .json

Embody 3D has a folder for each person of a capture, with a folder for each array of SMPL-X:

    CAPTURE/PERSON/smplx_mesh_body_pose/CAPTURE.npy    smplx_mesh_global_orient, ..._transl, ..._betas and others alike
    CAPTURE/PERSON/missing/CAPTURE.npy                 1 where the person was tracked well, 0 elsewhere
    CAPTURE/PERSON/separated_audio/CAPTURE.wav         speech of the person alone, in some captures

Both have 30 frames per second and do not say so in the files.
"""

import pathlib
import re
from collections.abc import Mapping

import numpy as np

from ha2g_jax.features import words as transcripts
from ha2g_jax.files.npz import read_npz
from ha2g_jax.files.reading import shown
from ha2g_jax.importers.mocap.options import ImportOptions
from ha2g_jax.motion.readers.recordings import MotionRecording

IS_GOOD = "is_good"
"""Array (T,) or (T, 1) of frames that can be used; others are 0."""

SEAMLESS_PREFIX = "smplh:"
SEAMLESS_NAME = re.compile(r"V\d+_S\d+_I\d+_(P\w+)")
"""Name of a recording of Seamless Interaction; the group is the speaker."""

_FPS = 30
_SEAMLESS = {"translation": "transl", "is_valid": IS_GOOD}
_CENTIMETRE = 0.01

_EMBODY_PREFIX = "smplx_mesh_"
_EMBODY_BODY = f"{_EMBODY_PREFIX}body_pose"
_EMBODY_PARTS = (
    *("body_pose", "global_orient", "left_hand_pose", "right_hand_pose", "jaw_pose", "leye_pose", "reye_pose"),
    *("transl", "betas"),
)
_EMBODY_GOOD, _EMBODY_AUDIO = "missing", "separated_audio"


def from_seamless(arrays: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    """Rename the arrays of Seamless Interaction, with the translation in metres and the frame rate.

    Args:
        arrays: arrays of a file by name; those of other data sets are returned as they are.
    """
    own = {name.removeprefix(SEAMLESS_PREFIX): it for name, it in arrays.items() if name.startswith(SEAMLESS_PREFIX)}
    if not own:
        return arrays
    renamed = {_SEAMLESS.get(name, name): array for name, array in own.items()}
    if "transl" in renamed and renamed["transl"].dtype.kind in "fiu":
        renamed["transl"] = renamed["transl"] * _CENTIMETRE
    return {"fps": np.array(_FPS)} | renamed


def find_embody(root: pathlib.Path, options: ImportOptions) -> list[MotionRecording]:
    """Find the people of the captures of Embody 3D in a folder, each of whom is a recording.

    Args:
        root: a folder of captures, such as `datasets/emotions`, one of a person in it, or a folder above them.
        options: options of the import, of which `speaker` is used.

    Returns:
        The recordings in order of their paths, none if the folder has another layout. The speaker is the person. A
        transcript lies beside the audio.
    """
    found = []
    for folder in sorted(root.rglob(_EMBODY_BODY)):
        person = folder.parent
        for path in sorted(folder.glob("[!.]*.npy")):
            audio = person / _EMBODY_AUDIO / f"{path.stem}.wav"
            words = transcripts.find(audio, is_alone=False)
            name = shown(f"{path.stem}--{person.name}")
            speaker = options.speaker or shown(person.name)
            given = audio if audio.is_file() else None
            found.append(MotionRecording(path, name, speaker, given, words, is_alone=False))
    return found


def is_embody(path: pathlib.Path) -> bool:
    """Return whether a file is one of the body poses that `find_embody` finds."""
    return path.parent.name == _EMBODY_BODY


def read_embody(path: pathlib.Path, max_bytes: int) -> dict[str, np.ndarray]:
    """Read the arrays of a person of Embody 3D.

    Args:
        path: path of the body poses.
        max_bytes: maximum size of an array.

    Raises:
        UserError: a file is damaged or too large.
    """
    arrays = {"fps": np.array(_FPS)}
    folders = {f"{_EMBODY_PREFIX}{part}": part for part in _EMBODY_PARTS} | {_EMBODY_GOOD: IS_GOOD}
    for folder, name in folders.items():
        part = path.parent.parent / folder / path.name
        if part.is_file():
            arrays[name] = next(iter(read_npz(part, max_bytes=max_bytes).values()))
    return arrays
