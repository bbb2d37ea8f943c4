"""A corpus whose dataset.json, shards or records are damaged is refused in one line, or its faults are listed."""

import contextlib
import io
import json
import pathlib
import re
import shutil

import msgpack
import numpy as np
import pytest
import soundfile
from fixtures.corpora import edit, write_records
from fuzz import recordings
from fuzz.conftest import within_limits
from fuzz.mutation import FUZZ, damaged_bytes, damaged_tree
from hypothesis import given
from hypothesis import strategies as st

from ha2g_jax.data import regroup, validation
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.records import Clip, Stroke, decode_clip, encode_clip
from ha2g_jax.data.windows import Windows
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.corpus_statistics import as_table, summarise
from ha2g_jax.features.text import Word
from ha2g_jax.metrics.beats.times import librosa
from ha2g_jax.skeleton import directions_to_positions, load_skeleton

SKELETON = load_skeleton("ted_gesture")
FRAMES = 45
CLIP = Clip(
    id="a",
    speaker="bo",
    audio=np.zeros(48000, np.float32),
    words=(Word("one", 0.1, 0.4), Word("two", 0.5, 0.9)),
    positions=np.tile(directions_to_positions(SKELETON, SKELETON.mean_directions), (FRAMES, 1, 1)).astype(np.float32),
    reference_images=np.zeros((2, 32, 32, 3), np.uint8),
    recording_start=0.0,
    window_starts=(0, 10),
    strokes=(Stroke(0.2, 0.1, 0.4, "beat", "left", 1.0, "one"),),
    style=(0.5, -0.5),
    recording="a",
    confidence=np.full((FRAMES, SKELETON.num_joints), 0.5, np.float32),
)
RECORD = encode_clip(CLIP)
FIELDS = msgpack.unpackb(RECORD)
REPORT = {"train": {"videos": 1, "clips": 1, "windows": 2, "kept": 2, "filtered": {"motion": 0}}}
METADATA = {"name": "tiny", "source": "test", "licence": "free", "import": REPORT, "video": {"settings": {}}}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """A corpus of one clip of training and two of validation."""
    librosa("onset")  # its import takes seconds, which are not those of a reader
    path = tmp_path_factory.mktemp("whole") / "corpus"
    with CorpusWriter(path, splits=("train", "val"), skeleton=SKELETON.name, fps=15, metadata=METADATA) as writer:
        writer.add("train", RECORD)
        for name in ("b", "c"):
            writer.add("val", encode_clip(_renamed(name)))
    return path


@pytest.fixture
def corpus(whole, tmp_path) -> pathlib.Path:
    return pathlib.Path(shutil.copytree(whole, tmp_path / "corpus"))


def _renamed(name: str) -> Clip:
    return Clip(**{**vars(CLIP), "id": name, "recording": name, "reference_images": None})


def _use_all(path: pathlib.Path) -> list[str]:
    """Do with a corpus what the commands do; return the lines of errors and the findings of the validation."""
    other = path.with_name("other")
    lines = []

    def windows() -> None:
        corpus = Corpus.open(path)
        for split in corpus.splits:
            opened = Windows(
                corpus,
                split,
                corpus.vocabulary(),
                num_frames=34,
                num_reference_images=2,
                inputs=("mel", "words", "plain_words"),
                image_size=32 if split == "train" else None,
            )
            for index in range(len(opened)):
                opened[index]

    uses = (
        lambda: lines.extend(validation.validate(path)),
        lambda: as_table(summarise(path)),
        windows,
        lambda: [decoded for split in Corpus.open(path).splits for decoded in Corpus.open(path).clips(split)],
        lambda: regroup.divide(path, other, by="recording", fractions={"train": 1, "val": 1}),
        lambda: regroup.merge([path, path.with_name("partner")], other),
    )
    for use in uses:
        with within_limits():
            try:
                use()
            except UserError as error:
                lines.append(str(error))
        shutil.rmtree(other, ignore_errors=True)
    assert all(line and "\n" not in line and len(line) < 1_000 for line in lines)
    return lines


@pytest.fixture(scope="module")
def place(whole, tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """Path at which a damaged corpus is put, beside a whole one to merge it with."""
    folder = tmp_path_factory.mktemp("place")
    shutil.copytree(whole, folder / "partner")
    return folder / "corpus"


def _put(whole: pathlib.Path, place: pathlib.Path) -> None:
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(whole, place)


@FUZZ
@given(st.data())
def test_damaged_description(whole, place, data):
    _put(whole, place)
    content = (whole / "dataset.json").read_bytes()
    trees = damaged_tree(json.loads(content)).map(lambda tree: json.dumps(tree).encode())
    (place / "dataset.json").write_bytes(data.draw(trees | damaged_bytes(content)))
    _use_all(place)


@FUZZ
@given(st.data())
def test_damaged_shard(whole, place, data):
    """The digest finds any damage; and without it, by whatever the library reads, nothing worse happens."""
    _put(whole, place)
    shard = place / "train-00000.array_record"
    content = data.draw(damaged_bytes(shard.read_bytes()))
    is_changed = content != shard.read_bytes()
    shard.write_bytes(content)
    edit(place, lambda dataset: dataset["splits"]["train"]["shards"][0].update(bytes=len(content)))
    lines = _use_all(place)
    assert not is_changed or any("SHA-256" in line for line in lines)


@FUZZ
@given(damaged_tree(FIELDS))
def test_damaged_fields(whole, place, fields):
    with contextlib.suppress(TypeError, ValueError, OverflowError):  # what msgpack cannot say
        record = msgpack.packb(fields, unicode_errors="surrogatepass")
        assert record is not None
        _put(whole, place)
        write_records(place, "train", [record])
        _use_all(place)


@FUZZ
@given(damaged_bytes(RECORD))
def test_damaged_record(whole, place, record):
    _put(whole, place)
    write_records(place, "train", [record])
    _use_all(place)


@FUZZ
@given(damaged_bytes(FIELDS["audio"]), damaged_bytes(FIELDS["reference_frames"][0]))
def test_damaged_media(audio, image):
    with within_limits(), contextlib.suppress(UserError):
        decode_clip(msgpack.packb(FIELDS | {"audio": audio}) or b"")
    with within_limits(), contextlib.suppress(UserError):
        decode_clip(msgpack.packb(FIELDS | {"reference_frames": [image]}) or b"")


def _flac_of_hours() -> bytes:
    file = io.BytesIO()
    with soundfile.SoundFile(file, "w", 16000, 1, format="FLAC") as sound:
        for _ in range(60):
            sound.write(np.zeros(16000 * 60, np.float32))
    return file.getvalue()


def _of(shape: list[int]) -> dict:
    return {"positions": {**FIELDS["positions"], "shape": shape}}


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (_of([2**32, 10, 3]), "cannot reshape array"),
        (_of([10**9, 10, 3]), "cannot reshape array"),
        ({"positions": {"shape": [0, 10, 3], "data": b""}}, "positions of shape .0, 10, 3."),
        ({"strokes": [[0, 0, 0, 0, 0, 0, 0]]}, "strokes of a wrong type"),
        ({"recording": 1}, "fields .'recording'|recording of a wrong type|damaged"),
        (lambda: {"audio": _flac_of_hours()}, "3600.00? s of audio"),
        ({"reference_frames": [recordings.png(30_000, 30_000)]}, "exceeds limit of"),
    ],
)
def test_a_record_whose_sizes_lie(corpus, change, expected):
    change = change() if callable(change) else change  # what takes long to make is made where it is needed
    write_records(corpus, "val", [msgpack.packb(FIELDS | change) or b""])
    with within_limits():
        lines = "\n".join(validation.validate(corpus))
    assert re.search(expected, lines), lines
    with within_limits(), pytest.raises(UserError, match=r"val-00000\.array_record"):
        list(Corpus.open(corpus).clips("val"))


@pytest.mark.parametrize("name", ["lengths", "mean_directions"])
@pytest.mark.parametrize("values", [[], [[0.1] * 3] * 100, "x", None, [True] * 9])
def test_statistics_of_another_skeleton(corpus, refused, name, values):
    edit(corpus, lambda data: data["statistics"].update({name: values}))
    line = refused("data", "stats", str(corpus))
    assert f"dataset.json is damaged (statistics: {name}" in line or "not JSON" in line
