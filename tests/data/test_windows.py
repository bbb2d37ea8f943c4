"""Windows cut what belongs together, and batches come in an order that can be repeated."""

import numpy as np
import pytest

from ha2g_jax.audio import SAMPLE_RATE, window_column
from ha2g_jax.data.corpus import Corpus, CorpusWriter
from ha2g_jax.data.records import Clip, encode_clip
from ha2g_jax.data.windows import Windows, batches, resize_frames
from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import load_skeleton, positions_to_directions
from ha2g_jax.text import UNKNOWN, Word

SKELETON = load_skeleton("ted_gesture")
NUM_FRAMES, EVENT = 60, 40


def _positions() -> np.ndarray:
    """A person who turns about the vertical by 0.02 rad a frame, so that the direction tells the frame."""
    angle = 0.02 * np.arange(NUM_FRAMES)
    zero, one = np.zeros_like(angle), np.ones_like(angle)
    turn = np.array([[np.cos(angle), zero, np.sin(angle)], [zero, one, zero], [-np.sin(angle), zero, np.cos(angle)]])
    return np.einsum("ijt,kj->tki", turn, SKELETON.mean_pose).astype(np.float32)


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Corpus:
    """One clip of 4 s in which a click, a word and a turn of the body meet in frame 40."""
    audio = np.zeros(NUM_FRAMES * SAMPLE_RATE // 15, np.float32)
    click = EVENT * SAMPLE_RATE // 15
    audio[click : click + 200] = np.random.default_rng(0).uniform(-0.5, 0.5, 200)
    clip = Clip(
        id="a",
        speaker="ada",
        audio=audio,
        words=(Word("long", 0.5, 1.5), Word("click", EVENT / 15, EVENT / 15 + 0.2)),
        positions=_positions(),
        reference_frames=np.full((4, 224, 224, 3), 90, np.uint8),
        source_time=0.0,
        window_starts=(0, 10, 20, 26, 30),
    )
    path = tmp_path_factory.mktemp("corpus") / "clicks"
    with CorpusWriter(path, splits=("train",), skeleton=SKELETON.name, fps=15, metadata={}) as writer:
        writer.add("train", encode_clip(clip))
    return Corpus.open(path)


@pytest.fixture
def windows(corpus: Corpus) -> Windows:
    return Windows(corpus, "train", corpus.vocabulary(), num_frames=34, num_reference_frames=4)


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
        assert abs(loudest - (window_column(EVENT) - window_column(start))) <= 1


def test_a_word_still_spoken_lies_on_the_first_frame(corpus, windows):
    long = corpus.vocabulary().encode("long")
    assert windows[1]["words"][0] == long  # frame 10 is 0.67 s, the word lasts from 0.5 to 1.5
    assert windows[2]["words"][0] == long  # 1.33 s
    assert (windows[3]["words"] != long).all()  # 1.73 s
    assert UNKNOWN not in windows[0]["words"]


def test_past_the_end_of_the_clip_is_silence(windows):
    # The clip has 126 columns, the last window takes 54 to 123 of them; one that is later reaches the end.
    assert windows.example(3, delay=5)["directions"].shape == (34, 9, 3)
    assert np.isfinite(windows[3]["mel"]).all() and windows[3]["mel"][:, -1].max() <= -79


def test_a_delay_shifts_everything(windows):
    delayed, later = windows.example(0, delay=10), windows[1]
    for name, array in later.items():
        np.testing.assert_array_equal(delayed[name], array)


def test_reference_frames_are_resized_once_per_clip(corpus):
    windows = Windows(corpus, "train", corpus.vocabulary(), num_frames=34, num_reference_frames=4, image_size=32)
    assert windows[0]["frames"].shape == (4, 32, 32, 3) and windows[0]["frames"].dtype == np.uint8
    assert windows[0]["frames"] is windows[1]["frames"]
    assert (resize_frames(np.full((1, 48, 48, 3), 7, np.uint8), 32) == 7).all()


def test_errors_say_what_to_do(corpus, windows):
    with pytest.raises(UserError, match="61 frames"):
        Windows(corpus, "train", corpus.vocabulary(), num_frames=61, num_reference_frames=4)
    with pytest.raises(UserError, match=r"identity\.kind=speakers"):
        Windows(corpus, "train", corpus.vocabulary(), num_frames=34, num_reference_frames=7, image_size=32)
    with pytest.raises(UserError, match="batch of 5 is more than the 4 windows"):
        batches(windows, 5, seed=0)


@pytest.fixture(scope="module")
def talk_windows(tiny_talk) -> Windows:
    corpus = Corpus.open(tiny_talk)
    return Windows(corpus, "train", corpus.vocabulary(), num_frames=34, num_reference_frames=4, jitter=9)


def _directions(iterator, count: int) -> np.ndarray:
    return np.stack([next(iterator)["directions"] for _ in range(count)])


def test_a_seed_gives_an_order(talk_windows):
    first, again, other = (_directions(batches(talk_windows, 8, seed), 3) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_each_epoch_has_every_window_in_another_order(tiny_talk):
    corpus = Corpus.open(tiny_talk)
    windows = Windows(corpus, "val", corpus.vocabulary(), num_frames=34, num_reference_frames=4)
    everything = sorted(windows[index]["directions"].tobytes() for index in range(len(windows)))
    iterator = batches(windows, 1, seed=0)
    first, second = ([next(iterator)["directions"][0].tobytes() for _ in windows] for _ in range(2))
    assert sorted(first) == everything == sorted(second)
    assert first != second


def test_an_iterator_continues_from_its_state(talk_windows):
    iterator = batches(talk_windows, 8, seed=0)
    _directions(iterator, 3)
    state = iterator.get_state()
    expected = _directions(iterator, 3)
    resumed = batches(talk_windows, 8, seed=0)
    resumed.set_state(state)
    np.testing.assert_array_equal(_directions(resumed, 3), expected)


def test_jitter_starts_windows_between_the_stored_starts(talk_windows):
    stored = {talk_windows[index]["directions"].tobytes() for index in range(len(talk_windows))}
    drawn = {example.tobytes() for example in _directions(batches(talk_windows, 8, seed=0), 4).reshape(32, 34, 42, 3)}
    assert len(drawn - stored) > 16
