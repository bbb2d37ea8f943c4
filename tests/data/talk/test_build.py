"""The Talk corpus: same bytes whatever the workers, splits that fraction nothing they must not, records that agree."""

import collections
import itertools
import os
import subprocess
import sys

import numpy as np
import pytest

from ha2g_jax.data import records
from ha2g_jax.data.corpus import TALK_VERSION, Corpus
from ha2g_jax.data.talk import build, grammar
from ha2g_jax.data.talk.speakers import sample_voice, say
from ha2g_jax.skeleton import load_skeleton


def test_workers_do_not_change_the_bytes(tiny_talk, tmp_path):
    build.make_talk(tmp_path / "again", speakers=4, minutes=2, seed=0, workers=2)
    files = sorted(file.name for file in tiny_talk.iterdir())
    assert files == sorted(file.name for file in (tmp_path / "again").iterdir())
    for name in files:
        assert (tiny_talk / name).read_bytes() == (tmp_path / "again" / name).read_bytes(), name


def test_the_processor_does_not_change_the_bytes(tiny_talk, tmp_path):
    """The name of a run has the hash of its corpus, which must be the same with AVX-512 and with AVX2 alone."""
    features = np.show_config(mode="dicts")["SIMD Extensions"]["found"]
    newer = [name for name in features if name.startswith(("AVX512", "X86_V4"))]
    if not newer:
        pytest.skip("the processor has no AVX-512")
    command = ["-m", "ha2g_jax.cli", "data", "make-talk", str(tmp_path / "avx2")]
    environment = os.environ | {"NPY_DISABLE_CPU_FEATURES": " ".join(newer), "OPENBLAS_CORETYPE": "Haswell"}
    size = ["--speakers", "4", "--minutes", "2", "--seed", "0"]
    subprocess.run([sys.executable, *command, *size], env=environment, check=True, capture_output=True)
    assert (tmp_path / "avx2" / "dataset.json").read_bytes() == (tiny_talk / "dataset.json").read_bytes()


def test_records_agree(tiny_talk):
    """Sound, words, motion, frames and truth of each clip cover the same time and are in range."""
    corpus = Corpus.open(tiny_talk)
    assert corpus.splits == build.SPLITS
    minutes = 0.0
    for split in corpus.splits:
        clips = corpus.clips(split)
        assert len(clips) > 0
        for clip in clips:
            seconds = len(clip.audio) / 16000
            minutes += seconds / 60
            assert 8 < seconds < 35
            assert clip.positions.shape == (round(seconds * 15), 43, 3)
            assert np.isfinite(clip.positions).all()
            assert 0.009 < np.abs(clip.audio).max() < 0.98
            assert clip.reference_images is not None
            assert clip.reference_images.shape == (7, 224, 224, 3)
            times = [time for word in clip.words for time in (word.start, word.end)]
            assert times == sorted(times)
            assert times[-1] <= seconds
            assert clip.window_starts[0] == 0
            assert clip.window_starts[-1] + 34 <= len(clip.positions)
            assert len(clip.style) == 6
            assert clip.strokes
            assert 50 < 60 * len(clip.words) / seconds < 280
    assert minutes == pytest.approx(2, rel=0.25)


def test_splits_share_no_recording_and_no_unseen_speaker(tiny_talk):
    corpus = Corpus.open(tiny_talk)
    recordings, speakers = collections.defaultdict(set), {}
    for split in corpus.splits:
        speakers[split] = {clip.speaker for clip in corpus.clips(split)}
        assert speakers[split] == set(corpus.speakers_of(split))
        for clip in corpus.clips(split):
            recordings[clip.recording].add(split)
    assert all(len(splits) == 1 for splits in recordings.values())
    assert not speakers["test_unseen_speakers"] & (speakers["train"] | speakers["val"] | speakers["test"])
    assert speakers["val"] | speakers["test"] <= speakers["train"]


def test_default_plan():
    """At the default size most seen speakers are tested, all unseen ones are, and no split is tiny."""
    plans = build._plan(48, 144, 0, "espeak-ng")
    clips, speakers = collections.Counter(), collections.defaultdict(set)
    for plan in plans:
        clips[plan.split] += plan.num_clips
        speakers[plan.split].add(plan.speaker)
    assert [len(speakers[split]) for split in ("train", "test_unseen_speakers")] == [40, 8]
    assert len(speakers["test"]) >= 20
    fraction = {split: count / clips.total() for split, count in clips.items()}
    assert fraction["train"] > 0.75
    assert min(fraction.values()) > 0.055
    assert len({plan.speaker.voice for plan in plans}) == 48
    kinds = collections.Counter((plan.split, plan.kind) for plan in plans)
    for kind in build._KINDS:
        assert 0.07 < kinds["train", kind] / fraction["train"] / clips.total() * 2 < 0.09 and kinds["val", kind]
    assert {plan.kind for plan in plans if plan.split.startswith("test")} == {"speech"}


def plan_of(kind: str) -> build._RecordingPlan:
    return build._plan(4, 4, 1, "espeak-ng")[0]._replace(kind=kind, num_clips=1)


def test_rest_has_sound_and_no_words_and_no_beat():
    made = build._make_clips(plan_of("rest")._replace(num_clips=3), 15)
    skeleton, clips = load_skeleton("ted_expressive"), [records.decode_clip(record) for record in made]
    assert sum(clip.audio.any() for clip in clips) >= 2
    for clip in clips:
        assert clip.words == () and not {stroke.kind for stroke in clip.strokes} & {"beat", "semantic"}
        wrists = clip.positions[:, [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]]
        assert np.linalg.norm(np.diff(wrists, axis=0), axis=-1).max() * 15 < 0.3


@pytest.mark.parametrize(("kind", "longest_gap"), [("two people", 7), ("no pauses", 0.1), ("no emphasis", 7)])
def test_kinds_of_speech(kind, longest_gap, monkeypatch):
    """Words lie where the sound is, in turn of two voices, and with next to nothing between them without pauses."""
    said, rng = [], np.random.default_rng(0)
    monkeypatch.setattr(build, "say", lambda markup, voice: said.append((markup, voice)) or say(markup, voice))
    plan = plan_of(kind)
    partner = sample_voice(rng, "en")
    voices = [plan.speaker.voice, partner] if kind == "two people" else [plan.speaker.voice]
    audio, words = build._speak(grammar.sentences(rng), voices, plan, rng)
    assert {voice for _, voice in said} == {*voices}
    assert any("<" in markup for markup, _ in said) == (kind != "no emphasis")
    gaps = [after.start - before.end for before, after in itertools.pairwise(words)]
    assert min(gaps) > -1e-3 and max(gaps) < longest_gap
    for word in words:
        audio[round((word.start - 0.02) * 16000) : round((word.end + 0.02) * 16000)] *= 1e-3
    assert np.abs(audio).max() < 0.2


@pytest.mark.parametrize(("speakers", "minutes"), [(8, 60), (42, 144), (84, 400)])
def test_validation_takes_each_speaker_before_any_twice(speakers, minutes):
    plans = [plan for plan in build._plan(speakers, minutes, 0, "espeak-ng") if plan.split == "val"]
    seen = speakers - build.num_unseen(speakers)
    assert len({plan.speaker.name for plan in plans}) == min(len(plans), seen)


def test_talk_path(monkeypatch, tmp_path, capsys):
    """The corpus called talk is built once, in the cache folder; any other name is a path."""
    calls = []

    def make(out):
        calls.append(out)
        out.mkdir(parents=True)

    monkeypatch.setenv("HA2G_CACHE", str(tmp_path))
    monkeypatch.setattr(build, "make_talk", make)
    assert build.talk_path("talk") == build.talk_path("talk") == tmp_path / TALK_VERSION
    assert len(calls) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and "is made once" in lines[0] and f"kept in {tmp_path / TALK_VERSION}" in lines[0]
    assert str(build.talk_path("some/folder")) == "some/folder"
