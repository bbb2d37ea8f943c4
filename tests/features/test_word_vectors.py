"""Word vectors come from every format in use, those of unknown words from fastText's n-grams; bad files are refused."""

import gzip
import struct
import tracemalloc

import numpy as np
import pytest
from fuzz.conftest import one_line
from fuzz.mutation import FUZZ, damaged_bytes
from hypothesis import given
from hypothesis import strategies as st

from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.features.word_vectors import read_word_vectors

VOCABULARY = Vocabulary(("two", "one", "three"))
ROWS = {"Two": [9.0, 9, 9], "two": [1.0, 2, 3], "other": [0.0, 0, 0], "TWO": [8.0, 8, 8], "One": [4.0, 5, 6]}


def fasttext_model(
    words,
    matrix,
    *,
    buckets=0,
    ngrams=(0, 0),
    version=12,
    model=2,
    labels=(),
    magic=793712314,
    num_pruned=-1,
    is_quantised=False,
    size=None,
    shape=None,
) -> bytes:
    """A model as fastText saves it, up to the output matrix, which no reader of vectors looks at."""
    matrix = np.asarray(matrix, "<f4")
    entries = [(word, 0) for word in words] + [(label, 1) for label in labels]
    parts = [
        struct.pack("<2i", magic, version),
        struct.pack("<12id", matrix.shape[1], 5, 1, 1, 5, 1, 2, model, buckets, *ngrams, 100, 1e-4),
        struct.pack("<3i2q", len(entries) if size is None else size, len(words), len(labels), 1000, num_pruned),
        *(word.encode() + b"\0" + struct.pack("<qb", 3, kind) for word, kind in entries),
        b"\0" * 8 * max(0, num_pruned),
        struct.pack("<?2q", is_quantised, *(shape or matrix.shape)),
        matrix.tobytes(),
    ]
    return b"".join(parts)


LINES = "".join(f"{word} {' '.join(map(str, row))}\n" for word, row in ROWS.items()).encode()
BINARY = b"".join(word.encode() + b" " + struct.pack("<3f", *row) + b"\n" for word, row in ROWS.items())
FILES = {
    "glove.txt": LINES + b". . . 7 7 7\n",
    "wiki.vec": b"5 3\n" + LINES.replace(b"\n", b" \n"),
    "wiki.vec.gz": gzip.compress(b"5 3\n" + LINES),
    "word2vec.bin": b"5 3\n" + BINARY,
    "WIKI.VEC.GZ": gzip.compress(b"5 3\n" + LINES),
    "word2vec.bin.gz": gzip.compress(b"5 3\n" + BINARY),
    "fasttext.bin": fasttext_model(ROWS, list(ROWS.values())),
    "supervised.bin": fasttext_model(ROWS, list(ROWS.values()), labels=["__label__a"], model=3),
    "fasttext under any name": fasttext_model(ROWS, list(ROWS.values())),
}


def _read(folder, name: str, content: bytes, vocabulary: Vocabulary = VOCABULARY, dim: int = 3) -> np.ndarray:
    (folder / name).write_bytes(content)
    return read_word_vectors(folder / name, vocabulary, dim)


@pytest.mark.parametrize("name", FILES)
def test_reads_word_vectors(tmp_path, name):
    table = _read(tmp_path, name, FILES[name])
    assert table.dtype == np.float32
    assert table.shape == (5, 3)
    np.testing.assert_array_equal(table[[2, 3]], [ROWS["two"], ROWS["One"]])
    np.testing.assert_array_equal(table, read_word_vectors(tmp_path / name, VOCABULARY, 3))


def test_a_word_with_spaces_is_not_taken_for_its_first_part(tmp_path):
    table = _read(tmp_path, "glove.txt", b"two 1 2 3\none of 7 7 7\n")
    assert not (table == 7).any()


def test_rows_that_the_file_lacks_have_length_about_one(tmp_path):
    table = _read(tmp_path, "v.txt", b"two " + b" ".join([b"0"] * 300), VOCABULARY, 300)
    lengths = np.linalg.norm(np.delete(table, VOCABULARY.encode("two"), axis=0), axis=1)
    assert ((lengths > 0.8) & (lengths < 1.2)).all()


# Words of the alphabets that matter for hashing, and the buckets of their n-grams of 2 to 4 characters among 5000,
# as the fastText library 0.9.2 gives them.
BUCKETS = {
    "ñu": [4483, 2202, 1172, 4308, 1254, 1282],
    "日本": [2687, 3587, 3759, 2409, 1157, 717],
    "a": [3750, 2600, 4806],
}


def test_vectors_of_subwords_are_those_of_fasttext(tmp_path):
    vocabulary = Vocabulary(tuple(BUCKETS))
    words = ["</s>", "日本"]
    numbered = np.arange(len(words) + 5000, dtype=np.float32)[:, None] + [0, 10000]
    table = _read(tmp_path, "a.bin", fasttext_model(words, numbered, buckets=5000, ngrams=(2, 4)), vocabulary, 2)
    for word, buckets in BUCKETS.items():
        rows = [len(words) + bucket for bucket in buckets] + [row for row in (0, 1) if words[row] == word]
        np.testing.assert_allclose(table[vocabulary.encode(word)], np.mean(numbered[rows], axis=0), rtol=1e-6)


def _bucket(ngram: str, buckets: int) -> int:
    """The published FNV-1a, which is fastText's for ASCII."""
    value = 2166136261
    for byte in ngram.encode("ascii"):
        value = (value ^ byte) * 16777619 % 2**32
    return value % buckets


def test_the_end_of_a_sentence_has_no_subwords_and_a_single_bracket_is_none(tmp_path):
    numbered = np.arange(5001, dtype=np.float32)[:, None]
    content = fasttext_model(["</s>"], numbered, buckets=5000, ngrams=(1, 1))
    table = _read(tmp_path, "a.bin", content, Vocabulary(("</s>", "a")), 1)
    np.testing.assert_array_equal(table[2:, 0], [0, 1 + _bucket("a", 5000)])


def test_a_word_that_the_model_knows_in_other_case_has_the_vector_of_that_spelling(tmp_path):
    numbered = np.arange(502, dtype=np.float32)[:, None]
    content = fasttext_model(["x", "May"], numbered, buckets=500, ngrams=(4, 4))
    table = _read(tmp_path, "a.bin", content, Vocabulary(("may",)), 1)
    rows = [1, *(2 + _bucket(ngram, 500) for ngram in ("<May", "May>"))]
    np.testing.assert_allclose(table[2], np.mean(rows), rtol=1e-6)


def test_models_of_format_11_for_classes_have_no_subwords(tmp_path):
    matrix = np.arange(11, dtype=np.float32)[:, None]
    content = fasttext_model(["two"], matrix, buckets=10, ngrams=(2, 3), version=11, model=3)
    assert _read(tmp_path, "a.bin", content, VOCABULARY, 1)[2] == 0


def test_few_rows_of_a_large_model_take_little_memory(tmp_path):
    words = ["two", *(f"word{number}" for number in range(1000))]
    content = fasttext_model(words, np.ones((1, 300)), shape=(len(words), 300))
    with (tmp_path / "a.bin").open("wb") as file:
        file.write(content)
        file.truncate(len(content) + 4 * 300 * 1000)
    tracemalloc.start()
    try:
        table = read_word_vectors(tmp_path / "a.bin", VOCABULARY, 300)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert (table[2] == 1).all()
    assert peak < 200_000  # the matrix has 1.2 MB


MODEL = fasttext_model(ROWS, list(ROWS.values()) + [[1, 1, 1]] * 4, buckets=4, ngrams=(2, 3))
BAD = {
    "wide.txt": (b"two 1 2 3 4\n", "vectors of 4 values"),
    "prose.txt": (b"it was a dark night\nindeed\n", "vectors of 4 values"),
    "negative.bin": (b"-1 3\n" + BINARY, "a count of -1 words"),
    "uneven.txt": (b"two 1 2 3\none 1 2\n", "line 2"),
    "letters.txt": (b"two a b c\n", "could not convert"),
    "nan.txt": (b"two 1 nan 3\n", "'two' that is not finite"),
    "endless.txt": (b"x" * (3 << 20), "vectors of 0 values"),
    "endless.bin": (b"5 3\n" + b"x" * (3 << 20), "a word without end"),
    "bomb.txt.gz": (gzip.compress((b"x" * 1_000 + b" 1 2 3\n") * 25_000), "unpacks to more than 100 times its size"),
    "quantised.ftz": (fasttext_model(["two"], [[1, 2, 3]], is_quantised=True), "quantised"),
    "young.bin": (fasttext_model(["two"], [[1, 2, 3]], version=13), "format 13"),
    "cut fasttext.bin": (MODEL[:-5], "cut off"),
    "many words.bin": (fasttext_model(["two"], [[1, 2, 3]], size=2**31 - 1), "a dictionary of 2147483647 entries"),
    "many rows.bin": (fasttext_model(["two"], [[1, 2, 3]], shape=(2**62, 3)), "cut off"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_word_vectors_are_refused_in_one_line_and_little_memory(tmp_path, name):
    content, message = BAD[name]
    if content is not None:
        (tmp_path / name).write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(UserError, match=message) as error:
            read_word_vectors(tmp_path / name, VOCABULARY, 3)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert "\n" not in str(error.value)
    assert peak < (4 << 20)


@FUZZ
@given(data=st.data(), whole=st.sampled_from([*FILES.items(), ("subwords.bin", MODEL)]))
def test_any_bytes_are_read_or_refused(tmp_path, data, whole):
    content = data.draw(damaged_bytes(whole[1]) | st.binary(max_size=300))
    with one_line():
        table = _read(tmp_path, whole[0], content)
        assert table.shape == (5, 3) and np.isfinite(table).all()
