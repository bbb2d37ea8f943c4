"""A study from folders of motion: the site that is published, and the key that is not."""

import datetime
import hashlib
import json
import pathlib
import secrets
from collections.abc import Sequence

from ha2g_jax.apps.user_study.design import Design, Planned, make_design
from ha2g_jax.apps.user_study.key import ATTENTION, RATING, Key, Stimulus, item_as_json, write_key
from ha2g_jax.apps.user_study.site import DEFAULT_TITLE, Wording, read_wording, write_site
from ha2g_jax.apps.user_study.sources import name_systems, read_sources
from ha2g_jax.apps.user_study.stimuli import render
from ha2g_jax.files.writing import check_new, whole_folder
from ha2g_jax.limits import MAX_SEED
from ha2g_jax.motion.formats.video import check_size
from ha2g_jax.motion.readers.joint_maps import AUTO

_ID_LETTERS = 16


def make_study(
    motions: Sequence[str],
    out: str | pathlib.Path,
    *,
    speech: pathlib.Path | None = None,
    protocol: Sequence[str] = (RATING,),
    clips: int | None = None,
    clip_seconds: float | None = None,
    per_participant: int = 24,
    attention: int = 2,
    title: str = DEFAULT_TITLE,
    consent: pathlib.Path | None = None,
    closing: pathlib.Path | None = None,
    post: str | None = None,
    size: int = 480,
    joint_map: str = AUTO,
    source_fps: float | None = None,
    seed: int | None = None,
) -> pathlib.Path:
    """Write a study, completely or not at all: `site/`, which is published, and `key.json`, which is not.

    Args:
        motions: folder of each system, as DIR or NAME=DIR, with motion of the same clips.
        out: folder to write, which does not exist or is empty.
        speech: folder of the sounds, see `sources.read_sources`.
        protocol: parts of the study, of `design.PARTS`.
        clips: number of clips, drawn at random; by default all.
        clip_seconds: length in seconds to which longer clips are cut.
        per_participant: items of each part that a participant answers at most, see `design.make_design`.
        attention: number of attention checks.
        title: title that participants see.
        consent: text file with what participants agree to, in paragraphs; by default a short text.
        closing: text file with what participants see at the end, such as a completion code.
        post: address that the answers are sent to; without it participants download them.
        size: side of the videos in pixels.
        joint_map: names of the joints, see `motion.readers.read_motion`.
        source_fps: frames per second of files that do not say it.
        seed: seed of all choices; drawn by default, so that the ids of the videos cannot be guessed.

    Returns:
        The folder.

    Raises:
        UserError: the folder exists or cannot be written, or the motion, the sound or a setting cannot be used.
    """
    out = pathlib.Path(out)
    check_size((size, size))
    wording = read_wording(title=title, consent=consent, closing=closing, post=post)
    check_new(out)
    seed = secrets.randbelow(MAX_SEED) if seed is None else seed
    systems = name_systems(motions)
    options = {"clips": clips, "clip_seconds": clip_seconds, "joint_map": joint_map, "source_fps": source_fps}
    sources = read_sources(systems, speech=speech, seed=seed, **options)
    design = make_design(
        list(systems),
        sources.durations,
        list(dict.fromkeys(protocol)),
        per_participant=per_participant,
        attention=attention,
        seed=seed,
    )
    with whole_folder(out) as folder:
        media = folder / "site" / "media"
        media.mkdir(parents=True)
        render(design.stimuli, sources, media, size=size)
        key = _make_key(design, media, list(systems), list(sources.durations), wording, seed)
        write_site(folder / "site", key, design.lists, wording)
        write_key(folder / "key.json", key)
    return out


def _make_key(
    design: Design, media: pathlib.Path, systems: list[str], clips: list[str], wording: Wording, seed: int
) -> Key:
    stimuli = {planned.id: _stimulus(planned, media / f"{planned.id}.mp4") for planned in design.stimuli}
    content = [wording, seed, systems, [item_as_json(item) for item in design.items], stimuli]
    study = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:_ID_LETTERS]
    return Key(
        study=study,
        title=wording.title,
        seed=seed,
        created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        systems=tuple(systems),
        clips=tuple(clips),
        stimuli=stimuli,
        items=design.items,
        per_participant=design.per_participant,
    )


def _stimulus(planned: Planned, video: pathlib.Path) -> Stimulus:
    with video.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    is_check = planned.scene.part == ATTENTION
    sound = None if is_check else planned.scene.clip
    return Stimulus(planned.system, planned.clip, planned.clip == sound, sound, digest)
