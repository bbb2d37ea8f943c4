"""A page hears the spectrogram and makes the motion that Python makes: of files, and while someone speaks."""

import itertools
import json
import pathlib
import shutil
import subprocess

import numpy as np
import pytest
import soundfile
import soxr
from fixtures.bundles import bundle

import ha2g_jax
from ha2g_jax.features.audio import read_audio
from ha2g_jax.features.spectrum import log_mel
from ha2g_jax.motion.control import Controls
from ha2g_jax.synthesis import Style, load_onnx
from ha2g_jax.synthesis.onnx_model import exported, write_page_description

ROOT = pathlib.Path(__file__).parents[4]
MODULES = ROOT / "integrations" / "web" / "node_modules"
SPEECH = ROOT / "examples" / "hello.wav"
MEDIAN, WORST = 0.01, 0.2  # degrees
# dB. At other rates the filters that resample differ; a band at the floor may differ by more than one that is heard.
TOLERANCES = {16000: 1e-3, 48000: 5e-3, 44100: 0.1, 22050: 0.1}
GAINS = (1, 1e-3)  # ordinary speech, and sound too faint to have 0 dB

FILES = (
    {},
    {"speaker": "speaker-03", "seed": 99},
    {"mixture": {"speaker-00": 1, "speaker-02": 3}, "energy": 0.5},
    {"speaker": "speaker-01", "variation": 0, "energy": 1.7},
)
STREAMS = (
    {
        "piece": 1600,
        "options": {"seed": 3},
        "changes": {
            2: {"cue": ["stop", 1.8]},
            3: {"cue": ["point:up", 2.0]},  # begins before, and has the arm at last
            5: {"state": "think"},
            12: {"cue": ["wave", 2.5]},
            30: {"clear": []},
            50: {"cue": ["nod"]},
            66: {"state": "think"},
            84: {"clear": [70]},
            95: {"cue": ["point:left", 10.6], "state": "listen"},
            97: {"cue": ["count:3"], "muted": True},
        },
    },
    {
        "piece": 1111,
        "options": {"lookAhead": 8, "hop": 3, "speaker": "speaker-01", "seed": 4, "energy": 1.4},
        "changes": {20: {"energy": 0.4, "muted": True}, 80: {"muted": False, "speaker": "speaker-03"}},
    },
    {"piece": 50000, "options": {"lookAhead": 34, "hop": 26, "reference": 20}},
)


@pytest.fixture(scope="session")
def page_program(tmp_path_factory):
    """The command that does jobs with a Gesturer, see gesturer.ts."""
    return bundle(pathlib.Path(__file__).with_name("gesturer.ts"), tmp_path_factory.mktemp("page"))


@pytest.fixture(scope="session")
def demo_folder(tmp_path_factory):
    """A folder with model.onnx and model.json of the demo."""
    folder = tmp_path_factory.mktemp("demo")
    path = pathlib.Path(shutil.copy(exported("demo"), folder / "model.onnx"))
    write_page_description(path)
    return folder


@pytest.fixture(scope="session")
def do_jobs(page_program, tmp_path_factory):
    """A function from the folder of a model and jobs to what `Gesturer` found, in the same order."""
    wasm = MODULES / "onnxruntime-web" / "dist" / "ort-wasm-simd-threaded.wasm"

    def do(folder, jobs):
        path = tmp_path_factory.mktemp("jobs") / "jobs.json"
        path.write_text(json.dumps(jobs, default=str))
        done = subprocess.run(
            [*page_program, folder, wasm, path], capture_output=True, text=True, check=False, timeout=300
        )
        assert done.returncode == 0, done.stderr
        answer = json.loads(done.stdout)
        assert answer["loading"][-1] == 1
        assert answer["loading"] == sorted(answer["loading"])
        return answer["found"]

    return do


@pytest.fixture(scope="module")
def speech_with_a_pause(tmp_path_factory):
    """A file with four seconds of faint noise, in which a stream rests, and one of the other, who speaks in it."""
    samples, rate = soundfile.read(SPEECH, dtype="float32")
    other = np.random.default_rng(1).normal(0, 1e-4, len(samples)).astype(np.float32)
    other[4 * rate : 6 * rate] += samples[: 2 * rate]
    samples[4 * rate : 8 * rate] = np.random.default_rng(0).normal(0, 1e-3, 4 * rate)
    folder = tmp_path_factory.mktemp("speech")
    for name, sound in (("pause.wav", samples), ("other.wav", other)):
        soundfile.write(folder / name, sound, rate, subtype="FLOAT")
    return {"sound": folder / "pause.wav", "other": folder / "other.wav"}


@pytest.fixture(scope="module")
def found(demo_folder, speech_with_a_pause, do_jobs, tmp_path_factory):
    """What a page found for each of FILES and STREAMS."""
    folder = tmp_path_factory.mktemp("motions")
    jobs = [{"options": options} for options in FILES] + [speech_with_a_pause | job for job in STREAMS]
    jobs = [{"sound": SPEECH, "out": folder / f"{index}.f32"} | job for index, job in enumerate(jobs)]
    answers = do_jobs(demo_folder, jobs)
    assert not [answer["error"] for answer in answers if "error" in answer]
    return [answer | {"directions": read(job["out"])} for job, answer in zip(jobs, answers, strict=True)]


def read(path):
    return np.fromfile(path, np.float32).reshape(-1, 42, 3)


def check_equal(found, expected):
    """Check that two motions (T, bones, 3) are equal within some hundredths of a degree."""
    assert found.shape == expected.shape
    chords = np.linalg.norm(found.astype(np.float64) - expected, axis=-1)
    degrees = np.rad2deg(2 * np.arcsin(np.minimum(chords / 2, 1)))
    assert np.median(degrees) < MEDIAN
    assert degrees.max() < WORST


@pytest.mark.parametrize("index", range(len(FILES)))
def test_a_file(demo_folder, found, index):
    options = dict(FILES[index])
    controls, seed = Controls(energy=options.pop("energy", 1.0)), options.pop("seed", 0)
    model = load_onnx(demo_folder / "model.onnx")
    motion = model.generate(str(SPEECH), style=Style(**options), seed=seed, controls=controls)
    check_equal(found[index]["directions"], motion.directions)
    assert found[index]["fractions"] == pytest.approx(np.arange(1, 10) / 9)
    here = {"version": None, "speech": None}  # a page knows no file
    assert found[index]["meta"] | here == json.loads(json.dumps(motion.meta)) | here


@pytest.mark.parametrize("index", range(len(STREAMS)))
def test_a_stream(found, index, speech_with_a_pause):
    expected, stream = streamed(ha2g_jax.load("demo"), speech_with_a_pause | STREAMS[index])
    check_equal(found[len(FILES) + index]["directions"], expected)
    assert found[len(FILES) + index]["latency"] == pytest.approx(stream.latency)
    assert found[len(FILES) + index]["state"] == stream.state


@pytest.mark.parametrize("kind", ["debug", "sampling"])
def test_a_model_without_hidden_ends(kind, request, do_jobs, tmp_path):
    """One that samples has the same takes in files and in streams."""
    model, path = (request.getfixturevalue(f"{kind}_{name}") for name in ("model", "onnx"))
    write_page_description(shutil.copy(path, tmp_path / "model.onnx"))
    options = {"speaker": "ada", "seed": 2}
    file, stream = jobs = [{"options": options}, {"options": options | {"hop": 5}, "piece": 4000}]
    for index, job in enumerate(jobs):
        job |= {"sound": SPEECH, "out": tmp_path / f"{index}.f32"}
    assert not [answer["error"] for answer in do_jobs(tmp_path, jobs) if "error" in answer]
    expected = model.generate(str(SPEECH), style=Style(speaker="ada"), seed=2)
    check_equal(read(file["out"]), expected.directions)
    check_equal(read(stream["out"]), streamed(model, stream)[0])


def streamed(model, job):
    """The frames (T, bones, 3) of a job, and Python's stream that made them."""
    options = dict(job["options"])
    style, controls = Style(speaker=options.pop("speaker", None)), Controls(energy=options.pop("energy", 1.0))
    ahead = {"look_ahead": options.pop("lookAhead")} if "lookAhead" in options else {}
    stream = model.stream(style=style, controls=controls, **ahead, **options)
    samples, frames = read_audio(job["sound"]), []
    others = read_audio(job["other"]) if "other" in job else None
    for index, start in enumerate(range(0, len(samples), job["piece"])):
        change = job.get("changes", {}).get(index, {})
        stream.muted = change.get("muted", stream.muted)
        stream.controls = Controls(energy=change.get("energy", stream.controls.energy))
        stream.style = Style(speaker=change["speaker"]) if "speaker" in change else stream.style
        stream.state = change.get("state", stream.state)
        if "cue" in change:
            stream.cue(*change["cue"])
        if "clear" in change:
            stream.clear(*change["clear"])
        end = start + job["piece"]
        frames.append(stream.feed(samples[start:end], None if others is None else others[start:end]))
    return np.concatenate([*frames, stream.flush()]), stream


def test_requests_that_fail_do_no_harm(demo_folder, do_jobs, tmp_path):
    """A motion that is cancelled, a seed without a take, and a file that is no sound; then a motion is made."""
    (tmp_path / "text.wav").write_text("no sound")
    jobs = [
        {"sound": SPEECH, "options": {}, "abort": True},
        {"sound": SPEECH, "options": {"seed": 100}},
        {"sound": SPEECH, "options": {"hop": 29}, "piece": 1000},
        {"sound": tmp_path / "text.wav", "options": {}},
        {"sound": SPEECH, "options": {}},
    ]
    jobs = [job | {"out": tmp_path / f"{index}.f32"} for index, job in enumerate(jobs)]
    *failed, last = do_jobs(demo_folder, jobs)
    assert [answer["error"] for answer in failed] == [
        "AbortError: This operation was aborted",
        "Error: the seed is 100; expected a whole number from 0 to 99",
        "Error: the hop is 29; expected 1 to 26 frames",
        "Error: the file is no WAV file",
    ]
    assert last["fractions"][-1] == 1


def test_a_model_file_that_is_cut_short_is_refused(demo_folder, do_jobs, tmp_path):
    content = (demo_folder / "model.onnx").read_bytes()
    (tmp_path / "model.onnx").write_bytes(content[: len(content) // 2])
    (tmp_path / "model.json").write_bytes((demo_folder / "model.json").read_bytes())
    with pytest.raises(AssertionError, match=r"the model cannot be used \(.*\); export it again"):
        do_jobs(tmp_path, [])


def test_the_description_of_another_model_is_refused(debug_onnx, do_jobs, tmp_path):
    page = write_page_description(shutil.copy(debug_onnx, tmp_path / "model.onnx"))
    page.write_text(page.read_text().replace(json.loads(page.read_text())["hash"], "0" * 16))
    with pytest.raises(AssertionError, match=r"model\.json is that of another model; write both again"):
        do_jobs(tmp_path, [])


@pytest.fixture(scope="module")
def spectrograms(demo_folder, do_jobs, tmp_path_factory):
    """For each rate and gain, the path of a file and the spectrogram (128, columns) of a page."""
    folder = tmp_path_factory.mktemp("sounds")
    samples, rate = soundfile.read(SPEECH, dtype="float32")
    paths = {}
    for new_rate, gain in itertools.product(TOLERANCES, GAINS):
        path = paths[new_rate, gain] = folder / f"{new_rate}_{gain}.wav"
        mono = gain * (soxr.resample(samples, rate, new_rate) if new_rate != rate else samples)
        stereo = np.stack([mono, 0.5 * mono], axis=1)
        soundfile.write(path, stereo, new_rate, subtype="PCM_24" if new_rate == 44100 else "PCM_16")
    jobs = [{"kind": "mel", "sound": path, "out": path.with_suffix(".f32")} for path in paths.values()]
    do_jobs(demo_folder, jobs)
    return {
        key: (path, np.fromfile(path.with_suffix(".f32"), np.float32).reshape(-1, 128).T) for key, path in paths.items()
    }


@pytest.mark.parametrize("gain", GAINS)
@pytest.mark.parametrize("rate", TOLERANCES)
def test_a_page_hears_the_same_spectrogram(spectrograms, rate, gain):
    path, found = spectrograms[rate, gain]
    expected = log_mel(read_audio(path))
    assert found.shape == expected.shape and (expected.max() == 0) == (gain == 1)
    assert np.abs(found - expected).max() < TOLERANCES[rate]
