"""Studies and answer files of simulated participants, as the site of a study writes them."""

import itertools
import json
import types

import numpy as np
import pytest

from ha2g_jax.study.user_study.key import ATTENTION, MISMATCH, PREFERENCE, RATING, Item, Key, Stimulus, write_key

EXPECTED = 4  # what attention checks ask for


def make_key(num_systems=3, num_clips=4, per_participant=None, title="Gestures"):
    """Return the key of a study in which every system is rated, compared and shown with other speech on every clip."""
    systems = tuple(f"system {letter}" for letter in "abcdef"[:num_systems])
    clips = tuple(f"clip{number}" for number in range(num_clips))
    stimuli, items = {}, []

    def stimulus(system, clip, sound_of):
        name = f"s{len(stimuli):03}"
        stimuli[name] = Stimulus(system, clip, clip == sound_of, sound_of, "0" * 64)
        return name

    def item(kind, *shown, expected=None):
        items.append(Item(f"i{len(items):03}", kind, shown, expected))

    matched = {(system, clip): stimulus(system, clip, clip) for system in systems for clip in clips}
    for system, clip in matched:
        item(RATING, matched[system, clip])
    for clip, pair in itertools.product(clips, itertools.combinations(systems, 2)):
        item(PREFERENCE, *(matched[system, clip] for system in pair))
    for number, (system, clip) in enumerate(matched):
        pair = (matched[system, clip], stimulus(system, clips[clips.index(clip) - 1], clip))
        item(MISMATCH, *(pair if number % 2 else pair[::-1]))
    item(ATTENTION, stimulus(systems[0], clips[0], None), expected=EXPECTED)
    kinds = [each.kind for each in items]
    counts = {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)} | (per_participant or {})
    created = "2026-01-02T03:04:05+00:00"
    return Key("c0ffee", title, 0, created, systems, clips, stimuli, tuple(items), counts)


def make_answers(key, participant, random, *, score=None, prefer=None, matched=0.7, equal=0.1):
    """Return the answers of a participant.

    Args:
        key: key of the study.
        participant: name of the participant.
        random: generator of the participant's choices.
        score: function of the index of a system and of a clip to a rating before rounding.
        prefer: function of two indices of systems to the probability of preferring the first.
        matched: probability of choosing the matched motion.
        equal: probability of choosing neither.
    """
    score = score or (lambda system, clip: 4 - 0.5 * system + random.normal(0, 0.7))
    prefer = prefer or (lambda first, second: 0.5 + 0.15 * (second - first))
    chosen = []
    for kind, count in key.per_participant.items():
        mine = [item for item in key.items if item.kind == kind]
        chosen += [mine[at] for at in random.permutation(len(mine))[:count]]
    answers = []
    for item in chosen:
        answer = {"item": item.id, "kind": item.kind, "seconds": 4.25, "plays": 1}
        stimuli = [key.stimuli[name] for name in item.stimuli]
        if item.kind == RATING:
            at = key.systems.index(stimuli[0].system), key.clips.index(stimuli[0].clip)
            ratings = {scale: int(np.clip(round(score(*at)), 1, 5)) for scale in key.scales}
            answer |= {"stimulus": item.stimuli[0], "ratings": ratings}
        elif item.kind == ATTENTION:
            answer |= {"stimulus": item.stimuli[0], "answer": item.expected}
        else:
            if item.kind == PREFERENCE:
                share = prefer(*(key.systems.index(stimulus.system) for stimulus in stimuli))
            else:
                share = matched if stimuli[0].matched else 1 - matched
            better = item.stimuli[0] if random.random() < share else item.stimuli[1]
            left, right = item.stimuli if random.random() < 0.5 else item.stimuli[::-1]
            choice = "equal" if random.random() < equal else "left" if better == left else "right"
            answer |= {"left": left, "right": right, "choice": choice}
        answers.append(answer)
    return {
        "format": "ha2g-study-answers",
        "version": 1,
        "study": key.study,
        "participant": participant,
        "started": "2026-02-03T04:05:06Z",
        "finished": "2026-02-03T04:25:06Z",
        "consent": True,
        "order": [item.id for item in chosen],
        "answers": answers,
        "comments": "",
        "client": {"user_agent": "Mozilla/5.0", "language": "en"},
    }


def write_study(folder, num_participants=6, **settings):
    """Write `study/key.json` and `answers/*.json` of a small study, and return the key."""
    key = make_key(**settings)
    write_key(folder / "study" / "key.json", key)
    (folder / "answers").mkdir(parents=True, exist_ok=True)
    for number in range(num_participants):
        content = make_answers(key, f"p{number:02}", np.random.default_rng(number))
        (folder / "answers" / f"p{number:02}.json").write_text(json.dumps(content))
    return key


@pytest.fixture
def study():
    """Functions that make a key, make answers and write both."""
    return types.SimpleNamespace(key=make_key, answers=make_answers, write=write_study)
