"""Windows cut what belongs together, decode only what is asked for, and name every record that cannot be used."""

import dataclasses
import pickle

import numpy as np
import pytest
from fixtures.corpora import write_corpus

from ha2g_jax.data import records
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.records import Clip, encode_clip
from ha2g_jax.data.windows import ClipCache, Windows, resize_images
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.spectrum import log_mel, sound_power, window_column
from ha2g_jax.features.text import UNKNOWN, Word
from ha2g_jax.skeleton import load_skeleton, positions_to_directions

SKELETON = load_skeleton("ted_gesture")
NUM_FRAMES, EVENT = 60, 40


def _positions() -> np.ndarray:
    """A person who rotates about the vertical by 0.02 rad a frame, so that the direction tells the frame."""
    angle = 0.02 * np.arange(NUM_FRAMES)
    zero, one = np.zeros_like(angle), np.ones_like(angle)
    rotation = np.array(
        [[np.cos(angle), zero, np.sin(angle)], [zero, one, zero], [-np.sin(angle), zero, np.cos(angle)]]
    )
    return np.einsum("ijt,kj->tki", rotation, SKELETON.mean_pose).astype(np.float32)


def _clip(name: str = "a", speaker: str = "ada", **changes) -> Clip:
    """A clip of 4 s in which a click, a word and a rotation of the body coincide in frame 40."""
    audio = np.zeros(NUM_FRAMES * SAMPLE_RATE // 15, np.float32)
    click = EVENT * SAMPLE_RATE // 15
    audio[click : click + 200] = np.random.default_rng(0).uniform(-0.5, 0.5, 200)
    clip = Clip(
        id=name,
        speaker=speaker,
        audio=audio,
        words=(Word("long", 0.5, 1.5), Word("click", EVENT / 15, EVENT / 15 + 0.2)),
        positions=_positions(),
        reference_images=np.full((4, 224, 224, 3), 90, np.uint8),
        recording_start=0.0,
        window_starts=(0, 10, 20, 26, 30),
    )
    return dataclasses.replace(clip, **changes)


def _write(path, *records: bytes) -> Corpus:
    """A corpus of the records, as its validation split."""
    return Corpus.open(write_corpus(path, {"train": [_clip()], "val": records}))


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Corpus:
    clips = [_clip(name, speaker) for name, speaker in (("b", "ada"), ("c", "ben"), ("d", "ada"))]
    return _write(tmp_path_factory.mktemp("corpus") / "clicks", *map(encode_clip, clips))


@pytest.fixture
def windows(corpus: Corpus) -> Windows:
    return Windows(corpus, "train", corpus.vocabulary(), num_frames=34, num_reference_images=4)


def test_windows_that_do_not_fit_the_clip_are_left_out(windows):
    assert len(windows) == 4  # 30 + 34 frames are more than 60


@pytest.mark.parametrize(("index", "start"), [(0, 0), (1, 10), (2, 20), (3, 26)])
def test_speech_and_motion_are_cut_at_the_same_time(corpus, windows, index, start):
    example = windows[index]
    assert example["mel"].shape == (128, 70) and example["mel"].dtype == np.float32
    expected = positions_to_directions(SKELETON, _positions())[start : start + 34]
    np.testing.assert_allclose(example["directions"], expected, atol=1e-6)
    if start + 34 > EVENT:
        assert example["words"][EVENT - start] == corpus.vocabulary().encode("click")
        loudest = example["mel"].max(axis=0).argmax()
        assert abs(loudest - (window_column(EVENT, 15) - window_column(start, 15))) <= 1


def test_a_word_still_spoken_lies_on_the_first_frame(corpus, windows):
    long = corpus.vocabulary().encode("long")
    assert windows[1]["words"][0] == long  # frame 10 is 0.67 s, the word lasts from 0.5 to 1.5
    assert windows[2]["words"][0] == long  # 1.33 s
    assert (windows[3]["words"] != long).all()  # 1.73 s
    assert UNKNOWN not in windows[0]["words"]


def test_the_first_frame_of_a_window_is_where_it_is_cut(windows):
    assert [windows.start_frame(3, delay) for delay in (0, 5, 99)] == [26, 26, 26]
    assert windows.start_frame(0, 3) == 3
    later = windows.example(0, delay=99)
    np.testing.assert_array_equal(later["directions"], windows.example(3)["directions"])


def test_the_power_of_a_clip_is_that_of_all_its_sound(corpus, windows):
    """Noise is added relative to it, in windows of silence too."""
    clip = next(iter(corpus.clips("train")))
    power = sound_power(np.power(10.0, log_mel(clip.audio) / 10))
    assert power > 0
    assert windows.clip_power(0) == windows.clip_power(1) == pytest.approx(power, rel=0.01)


def test_a_delay_shifts_everything(windows):
    delayed, later = windows.example(0, delay=10), windows[1]
    for name, array in later.items():
        np.testing.assert_array_equal(delayed[name], array)


def test_reference_frames_are_resized_once_per_clip(corpus):
    windows = Windows(corpus, "train", corpus.vocabulary(), num_frames=34, num_reference_images=4, image_size=32)
    assert windows[0]["images"].shape == (4, 32, 32, 3) and windows[0]["images"].dtype == np.uint8
    assert windows[0]["images"] is windows[1]["images"]
    assert (resize_images(np.full((1, 48, 48, 3), 7, np.uint8), 32) == 7).all()


def _val(corpus: Corpus, **options) -> Windows:
    return Windows(corpus, "val", corpus.vocabulary(), num_frames=34, num_reference_images=4, **options)


@pytest.fixture
def count_decoding(monkeypatch):
    """How often audio and images of a clip were decoded."""
    counts = {"audio": 0, "images": 0}
    for kind in counts:
        decode = getattr(records, f"decode_{kind}")

        def counted(*arguments, kind=kind, decode=decode):
            counts[kind] += 1
            return decode(*arguments)

        monkeypatch.setattr(records, f"decode_{kind}", counted)
    return counts


def test_a_clip_is_decoded_when_asked_for_and_then_kept(corpus, count_decoding):
    windows = _val(corpus, image_size=32)
    assert count_decoding == {"audio": 0, "images": 0}
    for index in range(4):  # the windows of clip b
        windows[index]
    assert count_decoding == {"audio": 1, "images": 1}
    windows[4]
    assert count_decoding == {"audio": 2, "images": 2}


def test_the_cache_keeps_to_its_size(corpus, count_decoding):
    """A cache of two of three clips drops the one longest unused; a cache of none still works."""
    track = _val(corpus)._read.track(0)
    size = track.speech.num_bytes + track.directions.nbytes + 1000
    windows = _val(corpus, cache_bytes=2 * size)
    count_decoding["audio"] = 0
    for index in (0, 4, 0, 8, 0):  # of clips b, c, b, d, b
        windows[index]
    assert count_decoding["audio"] == 3
    windows[4]
    assert count_decoding["audio"] == 4
    bare = windows.with_cache(0)
    for index in (0, 0):
        np.testing.assert_array_equal(bare[index]["mel"], windows[index]["mel"])
    assert count_decoding["audio"] == 6


def test_motion_and_images_decode_no_speech(corpus, count_decoding):
    windows = _val(corpus, image_size=32)
    motion = [windows.directions(index) for index in range(len(windows))]
    assert count_decoding == {"audio": 0, "images": 0}
    ada = corpus.speakers.index("ada")
    assert len(windows.reference_images(ada, limit=1)) == 1
    assert count_decoding == {"audio": 0, "images": 1}
    assert [images.shape for images in windows.reference_images(ada)] == [(4, 32, 32, 3)] * 2
    assert _val(corpus).reference_images(ada) == []
    for index in range(len(windows)):
        np.testing.assert_array_equal(motion[index], windows[index]["directions"])


def test_a_pickled_copy_is_small_and_equal(corpus):
    windows = _val(corpus, image_size=224)
    windows.directions(0)
    expected = windows[5]
    data = pickle.dumps(windows)
    assert len(data) < 20_000 < expected["images"].nbytes
    for name, array in pickle.loads(data)[5].items():
        np.testing.assert_array_equal(array, expected[name])


def test_kept_arrays_cannot_be_written_to(corpus):
    """They are shared by all windows of a clip."""
    with pytest.raises(ValueError, match="read-only"):
        _val(corpus)[0]["directions"][0] = 0


def test_two_threads_that_decode_one_clip_get_one_track(corpus):
    """While one decodes, another may have put the same clip into the cache; that one stays."""
    track = _val(corpus)._read.track(0)

    def decode(number):
        if not calls:
            calls.append(number)
            cache[number]  # the other thread, at the worst moment
        return track._replace(directions=track.directions.copy())

    calls: list[int] = []
    cache = ClipCache(decode, 1 << 20)
    assert cache[0] is cache.peek(0) is cache[0]


def test_a_record_without_its_images_is_named_at_the_start(tmp_path):
    corpus = _write(tmp_path / "corpus", encode_clip(_clip("good")), encode_clip(_clip("bad", reference_images=None)))
    with pytest.raises(UserError, match=r"clip 'bad' \(record 1 of .* has 0 images .*identity\.kind=speakers"):
        _val(corpus, image_size=32)
