"""Words fall on the frames in which they start; vectors come from the three formats in use."""

import gzip
import struct

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.text import UNKNOWN, Vocabulary, Word, read_word_vectors, words_to_frames

VOCABULARY = Vocabulary.from_words(["two", "one", "Two", "three"])


def test_vocabulary_is_most_frequent_first_and_ignores_case():
    assert VOCABULARY.words == ("two", "one", "three")
    assert len(VOCABULARY) == 5
    assert [VOCABULARY.encode(word) for word in ("two", "ONE", "three", "never")] == [2, 3, 4, UNKNOWN]


def test_words_lie_on_the_frame_in_which_they_start():
    words = [Word("one", 1.0, 1.2), Word("two", 1.2, 1.4), Word("never", 2.0, 2.1)]
    frames = words_to_frames(words, VOCABULARY, 1.0, 16, 15)
    assert frames.dtype == np.int32
    assert {frame: frames[frame] for frame in np.flatnonzero(frames)} == {0: 3, 3: 2, 15: UNKNOWN}


def test_a_word_from_before_the_window_counts_while_it_is_spoken():
    assert words_to_frames([Word("one", 0.5, 1.1)], VOCABULARY, 1.0, 34, 15)[0] == 3
    assert not words_to_frames([Word("one", 0.5, 1.0)], VOCABULARY, 1.0, 34, 15).any()


def test_the_later_of_two_words_in_a_frame_stays_and_the_end_is_open():
    words = [Word("one", 0.01, 0.02), Word("two", 0.03, 0.04), Word("three", 34 / 15, 3)]
    frames = words_to_frames(words, VOCABULARY, 0.0, 34, 15)
    assert frames[0] == 2
    assert np.count_nonzero(frames) == 1


@pytest.mark.parametrize("frame", range(34))
def test_a_start_on_a_frame_border_belongs_to_the_frame_it_opens(frame):
    start = 731 / 15
    frames = words_to_frames([Word("one", start + frame / 15, 99)], VOCABULARY, start, 34, 15)
    assert np.flatnonzero(frames).tolist() == [frame]


ROWS = {"Two": [9.0, 9, 9], "two": [1.0, 2, 3], "other": [0.0, 0, 0], "TWO": [8.0, 8, 8], "One": [4.0, 5, 6]}
LINES = "".join(f"{word} {' '.join(map(str, row))}\n" for word, row in ROWS.items()).encode()
BINARY = b"".join(word.encode() + b" " + struct.pack("<3f", *row) + b"\n" for word, row in ROWS.items())
FILES = {
    "glove.txt": LINES + b". . . 7 7 7\n",
    "wiki.vec": b"5 3\n" + LINES,
    "wiki.vec.gz": gzip.compress(b"5 3\n" + LINES),
    "word2vec.bin": b"5 3\n" + BINARY,
    "word2vec.bin.gz": gzip.compress(b"5 3\n" + BINARY),
}


@pytest.mark.parametrize("name", FILES)
def test_reads_word_vectors(tmp_path, name):
    (tmp_path / name).write_bytes(FILES[name])
    table = read_word_vectors(tmp_path / name, VOCABULARY, 3)
    assert table.dtype == np.float32
    assert table.shape == (5, 3)
    np.testing.assert_array_equal(table[[2, 3]], [ROWS["two"], ROWS["One"]])
    np.testing.assert_array_equal(table, read_word_vectors(tmp_path / name, VOCABULARY, 3))


def test_rows_that_the_file_lacks_have_length_about_one(tmp_path):
    (tmp_path / "v.txt").write_text("nothing " + " ".join(["0"] * 300))
    lengths = np.linalg.norm(read_word_vectors(tmp_path / "v.txt", VOCABULARY, 300), axis=1)
    assert ((lengths > 0.8) & (lengths < 1.2)).all()


BAD = {
    "missing.txt": (None, "no word vectors at"),
    "wide.txt": (b"two 1 2 3 4\n", "vectors of 4 values"),
    "prose.txt": (b"it was a dark night\nindeed\n", "vectors of 4 values"),
    "uneven.txt": (b"two 1 2 3\none 1 2\n", "line 2"),
    "letters.txt": (b"two a b c\n", "could not convert"),
    "cut.bin": (b"5 3\n" + BINARY[:20], "ends early"),
    "header.bin": (b"\x93\x00\x01", "not a file of word vectors"),
    "packed.txt.gz": (b"two 1 2 3\n", "not a file of word vectors"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_word_vectors_are_refused_in_one_line(tmp_path, name):
    content, message = BAD[name]
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(UserError, match=message) as error:
        read_word_vectors(tmp_path / name, VOCABULARY, 3)
    assert "\n" not in str(error.value)
