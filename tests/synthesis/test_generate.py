"""Speech of any length becomes exactly the frames it should, the same ones every time."""

import dataclasses
import importlib.resources
import itertools
import pathlib
import types
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import ha2g_jax
from ha2g_jax import synthesis
from ha2g_jax.checkpoint import model_folder
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import read_audio
from ha2g_jax.features.noise import track
from ha2g_jax.features.spectrum import log_mel, mel_window
from ha2g_jax.methods import METHODS
from ha2g_jax.methods.ha2g import method as ha2g
from ha2g_jax.methods.method import restore, subtract_mean
from ha2g_jax.metrics.seams import WIDTH, seam_score
from ha2g_jax.motion import rigs
from ha2g_jax.motion.control import Controls
from ha2g_jax.motion.cues import Cue
from ha2g_jax.motion.resample import resample
from ha2g_jax.synthesis import Style, scan
from ha2g_jax.synthesis.generator import read_seed_pose


def speech(seconds: float, seed: int = 0, pace: float = 2) -> np.ndarray:
    """Noise with the rhythm of syllables, twice `pace` of them a second."""
    time = np.arange(round(seconds * 16000)) / 16000
    samples = np.random.default_rng(seed).normal(0, 0.1, len(time)) * np.sin(2 * np.pi * pace * time) ** 2
    return samples.astype(np.float32)


@pytest.mark.parametrize(
    ("seconds", "fps"),
    [
        *itertools.product([0.2, 0.5, 1.5, 2.0, 2.2667, 2.27, 2.3, 4.2667, 8, 30, 61.7], [None, 29.97]),
        *itertools.product([2.27], [15, 24, 30, 60, 240]),
    ],
)
def test_frames_are_duration_times_fps_rounded(debug_model, seconds, fps):
    audio = speech(seconds)
    motion = debug_model.generate(audio, fps=fps)
    frames = round(len(audio) / 16000 * (fps or 15))
    assert motion.directions.shape == (frames, 42, 3)
    assert motion.positions.shape == (frames, 43, 3)
    assert motion.directions.dtype == motion.positions.dtype == np.float32
    assert motion.fps == (fps or 15)
    np.testing.assert_allclose(np.linalg.norm(motion.directions, axis=-1), 1, atol=1e-5)


def test_what_a_notebook_prints_has_one_short_line(debug_model, tiny_talk):
    corpus = Corpus.open(tiny_talk)
    motion = debug_model.generate((speech(1), 16000))
    armature = rigs.ha2g_armature(motion.skeleton)
    shown = [debug_model, debug_model.spec, debug_model.assets, debug_model.assets.vocabulary, debug_model.stream()]
    shown += [corpus, corpus.clips("train"), corpus.clips("train")[0], motion, motion.skeleton, armature]
    shown += [synthesis.read_speech(speech(1)), model_folder.load("demo")]
    for value in shown:
        text = repr(value)
        assert text.startswith(f"{type(value).__name__}(") and len(text) < 300 and "array" not in text
    assert repr(motion) == "Motion(15 frames, 15 fps, 1.00 s, ted_expressive)"
    assert debug_model.speakers == tuple(debug_model.assets.speakers)


def test_the_package_names_what_it_has():
    for module in (ha2g_jax, synthesis):
        assert set(module.__all__) <= set(dir(module))
        assert all(callable(getattr(module, name)) for name in module.__all__)


def test_frames_of_another_rate_lie_on_those_of_the_models_rate(debug_model):
    at_15, at_30 = (debug_model.generate(speech(3), fps=fps).directions for fps in (15, 30))
    np.testing.assert_allclose(at_30[::2], at_15, atol=1e-5)


def test_each_window_hears_its_own_piece_of_the_sound(debug_model):
    audio = speech(10)
    heard = synthesis.encode_features(debug_model, audio)
    mel = log_mel(audio)
    windows = np.stack([mel_window(mel, 20 * window, 34, 15) for window in range(7)])
    stand_alone = ha2g.encode_speech(debug_model.spec, debug_model.variables, {"mel": windows})
    for level, alone in zip(heard, stand_alone, strict=True):
        for window in range(7):
            part = level[20 * window + 7 : 20 * window + 27]
            np.testing.assert_allclose(part, np.asarray(alone)[window, 7 : 7 + len(part)], atol=1e-5)


def test_another_seed_is_another_take_of_a_model_that_samples(debug_model, sampling_model):
    """HA2G takes only its seed pose and its style from the seed."""
    pose, style = debug_model.assets.seed_poses[0], Style(speaker="ada", variation=0)
    for model, differs in ((debug_model, False), (sampling_model, True)):
        takes = [model.generate(speech(6), seed=seed, style=style, seed_pose=pose).directions for seed in (0, 1, 1)]
        np.testing.assert_array_equal(takes[1], takes[2])
        assert (np.abs(takes[0] - takes[1])[4:].mean() > 0.02) == differs
        assert differs or np.array_equal(takes[0], takes[1])


def test_speech_that_goes_on_does_not_change_what_was_before(debug_model):
    """Neither the windows after it nor the padding of their number has an influence."""
    audio = speech(20)
    audio[100] = 5  # the maximum that both clips are measured by
    f_id = np.zeros(18, np.float32)
    long = synthesis.generate_directions(debug_model, audio, f_id)
    for windows in (1, 2, 3, 5, 8):
        frames = 34 + 20 * (windows - 1)
        short = synthesis.generate_directions(debug_model, audio[: frames * 16000 // 15], f_id)
        # The last window of the short clip fades into nothing, and its last column hears the end.
        np.testing.assert_allclose(short[: frames - 34], long[: frames - 34], atol=1e-5)


def test_no_further_length_of_speech_compiles_a_program(debug_model, compilations):
    debug_model.generate(speech(5))
    with compilations() as compiled:
        for seconds in range(1, 21):
            debug_model.generate(speech(seconds))
    assert not compiled
    with compilations() as compiled:
        jax.jit(lambda: 1)()
    assert compiled  # so that the events are those that JAX records


def test_the_borders_of_chunks_leave_no_trace(debug_model, monkeypatch):
    audio, f_id = speech(19), np.zeros(18, np.float32)
    usual = synthesis.generate_directions(debug_model, audio, f_id)
    monkeypatch.setattr(scan, "_CHUNK", 11)
    np.testing.assert_allclose(synthesis.generate_directions(debug_model, audio, f_id), usual, atol=1e-5)


def test_encoding_ends_with_the_sampling(debug_model, monkeypatch):
    """Protects Ctrl-C in a long recording, which would wait until all of it is encoded."""
    encoded = []
    monkeypatch.setattr(scan, "_sample", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    encode = scan._encode_speech
    monkeypatch.setattr(scan, "_encode_speech", lambda *inputs: encoded.append(1) or encode(*inputs))
    with pytest.raises(KeyboardInterrupt):
        debug_model.generate(speech(600))
    assert 1 <= len(encoded) < 20  # of 75


def test_each_window_has_its_noise_and_poses_of_the_one_before(debug_model, monkeypatch):
    """A method that adds noise to what it is given, against a loop over the windows."""
    spec = debug_model.spec._replace(method="echo", noise_dim=debug_model.spec.skeleton.pose_dim)
    frames, overlap = spec.num_frames, spec.num_seed_frames
    stride = spec.window_stride

    def sample(spec, variables, features, style, seed_pose, noise):
        del spec, variables, style
        return noise + features["mel"] + jnp.tile(seed_pose, (1, frames // overlap + 1, 1))[:, :frames]

    monkeypatch.setitem(METHODS, "echo", types.SimpleNamespace(sample=sample))
    features = {"mel": np.random.default_rng(0).normal(size=(8, frames, 1)).astype(np.float32)}
    pose = debug_model.assets.seed_poses[0]
    chunks = (jax.tree.map(lambda x, at=at: x[at : at + 4], features) for at in (0, 4))
    found = scan.sample_windows(spec, {}, chunks, np.zeros(18), pose, seed=5, count=6)
    assert len(found) == 6
    noise = track(5, np.arange(6 * frames), spec.fps, spec.noise_dim)
    for index, window in enumerate(found):
        mel, first = features["mel"][index], index * stride
        arguments = subtract_mean(spec, pose)[None], noise[None, first : first + frames]
        expected = sample(None, None, {"mel": mel[None]}, None, *arguments)
        np.testing.assert_allclose(window, restore(spec, expected[0]), atol=1e-5)
        pose = window[stride : stride + overlap]


@pytest.fixture(scope="module")
def demo():
    if not (importlib.resources.files("ha2g_jax") / "assets" / "demo").is_dir():
        pytest.skip("no demo model in this checkout")
    return synthesis.load("demo")


def test_the_demo_moves_as_it_did(demo):
    """The wrists in four frames of examples/hello.wav are those of version 0.1.0."""
    example = pathlib.Path(__file__).parents[2] / "examples" / "hello.wav"
    motion = demo.generate(example, seed=0, style=Style(speaker="speaker-00"))
    wrists = [motion.skeleton.joint(name) for name in ("left_wrist", "right_wrist")]
    expected = [
        [[0.1885, 0.1711, -0.3775], [-0.4235, 0.0699, -0.2809]],
        [[0.6324, -0.0120, -0.3647], [-0.5450, 0.0940, -0.3079]],
        [[0.3922, 0.1472, -0.3949], [-0.5028, 0.0962, -0.3211]],
        [[0.0445, 0.2069, -0.4658], [-0.6871, 0.0761, -0.1252]],
    ]
    np.testing.assert_allclose(motion.positions[[0, 30, 60, 90]][:, wrists], expected, atol=1e-3)


@pytest.fixture(scope="module")
def performed(demo):
    """What the demo performs for a minute in three styles, and the same with two frames left out at each border."""
    clips, jumping = [], []
    for seed in range(2):
        audio = speech(61, seed, pace=1.87)  # no multiple of the windows' 2 s, or strokes would come at their borders
        clips.append(clip := demo.generate(audio, seed=seed).directions)
        frames = np.arange(len(clip))
        jumping.append(clip[np.minimum(frames + 2 * (frames // 30), len(clip) - 1)])
    return clips, jumping


@pytest.mark.parametrize("fps", [15, 60])
def test_the_demo_has_no_seams(performed, fps):
    """Speeds where windows join are like those inside windows; where frames are left out, the same test finds them."""
    clips, jumping = performed

    def score(clips):
        times = fps // 15
        finer = [resample(clip, 15, fps, times * len(clip) - times) for clip in clips]
        # A frame between two of the source belongs to the later one.
        borders = [times * (np.arange(30, len(clip) - 34, 30) - 1) + 1 for clip in clips]
        return seam_score(finer, borders, fps, width=times * WIDTH, first_frame=4 * times)

    found, control = score(clips), score(jumping)
    assert found.borders == control.borders > 50
    assert found.velocity_p > 0.05 > control.acceleration_p
    # Windows may meet closely, so that the easing makes the motion there calmer than elsewhere.
    assert 0.6 < found.velocity < 1.05
    # The windows of a model that samples meet less closely, by far less than two frames.
    assert 0.6 < found.acceleration < 1 + 0.2 * (control.acceleration - 1)


def test_frames_past_the_models_last_one_move_on(debug_model):
    """At another rate the last frames show what the window goes on to, not a pose that stands still."""
    motion = debug_model.generate(speech(3), fps=60)
    assert np.linalg.norm(np.diff(motion.directions[-4:], axis=0), axis=-1).max(axis=1).min() > 1e-6


def test_the_seed_decides_everything_random(debug_model):
    audio = speech(3)
    first, again, other = (debug_model.generate(audio, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.directions, again.directions)
    assert np.abs(first.directions - other.directions).max() > 1e-4
    assert first.meta["seed"] == 1


def chosen(model, *arguments, **options):
    return synthesis.choose_style(model.spec, model.variables, model.assets, *arguments, **options)


def test_the_style_comes_from_one_source(debug_model, tmp_path):
    Image.new("RGB", (90, 50), (200, 30, 90)).save(tmp_path / "wide.png")
    Image.new("L", (20, 300), 40).save(tmp_path / "tall.jpg")
    images = [tmp_path / "wide.png", str(tmp_path / "tall.jpg")]
    choices = {
        "ada": Style(speaker="ada"),
        "ben": Style(speaker="ben"),
        "images": Style(images=images),
        "image": Style(images=images[0]),
        "seed": Style(seed=7),
        "default": Style(),
    }
    styles = {name: chosen(debug_model, choice) for name, choice in choices.items()}
    assert all(f_id.shape == (18,) for f_id, _ in styles.values())
    assert len({f_id.tobytes() for f_id, _ in styles.values()}) == len(choices)
    assert styles["images"][1] == {
        "kind": "images",
        "images": ["wide.png", "tall.jpg"],
        "variation": 0.3,
    }
    assert debug_model.generate(speech(1), style=Style(speaker="ada")).meta["style"] == {
        "kind": "speaker",
        "speaker": "ada",
        "variation": 0.3,
    }
    np.testing.assert_array_equal(styles["seed"][0], chosen(debug_model, seed=7)[0])
    with pytest.raises(UserError, match="more than one source"):
        chosen(debug_model, Style(speaker="ada", seed=1))


def test_another_seed_is_another_take_of_a_speaker(debug_model):
    exact, described = chosen(debug_model, Style(speaker="ada", variation=0), seed=3)
    np.testing.assert_array_equal(exact, debug_model.assets.speakers["ada"])
    assert described == {"kind": "speaker", "speaker": "ada", "variation": 0}
    takes = np.stack([chosen(debug_model, Style(speaker="ada", variation=0.5), seed=seed)[0] for seed in range(200)])
    np.testing.assert_array_equal(takes[7], chosen(debug_model, Style(speaker="ada", variation=0.5), seed=7)[0])
    np.testing.assert_allclose(takes.mean(axis=0), exact, atol=0.15)
    np.testing.assert_allclose(takes.std(axis=0), 0.5, atol=0.1)


@pytest.mark.parametrize(
    "samples", [np.zeros((16000, 2), np.float32), np.zeros(16000, np.int16), speech(0.1), np.full(16000, np.nan)]
)
def test_bad_samples_are_refused(debug_model, samples):
    with pytest.raises(UserError):
        debug_model.generate(samples)


def test_a_speaker_table_takes_no_images(debug_model):
    model = dataclasses.replace(debug_model, spec=debug_model.spec._replace(identity="speaker"))
    with pytest.raises(UserError, match="speakers by name"):
        model.generate(speech(1), style=Style(images=[__file__]))


@pytest.mark.parametrize(("constant", "frequency", "phase"), [(0.05, 5, 0), (-0.05, 25, 0), (0.02, 29.9, 1.6)])
def test_the_demo_does_not_move_by_what_nobody_hears(demo, constant, frequency, phase):
    speech = read_audio(pathlib.Path(__file__).parents[2] / "examples" / "hello.wav")[:64000]
    seconds = np.arange(len(speech), dtype=np.float32) / 16000
    added = constant + 0.01 * np.sin(2 * np.pi * frequency * seconds + phase)
    style = Style(speaker="speaker-00")
    first, second = (demo.generate(samples, style=style).positions for samples in (speech, speech + added))
    assert np.linalg.norm(second - first, axis=-1).max() < 0.001


@pytest.mark.parametrize("package", [np, jnp])
def test_numbers_of_numpy_and_jax_are_numbers(debug_model, tmp_path, package):
    """As of a loop over np.arange, or of weights that another model gave."""
    half, one, yes = cast(Any, (package.float32(0.5), package.float32(1), package.bool_(True)))
    other = package.int32(3), half, package.float32(15), yes, one
    for name, (seed, part, fps, mirror, weight) in (("a", (3, 0.5, 15.0, True, 1.0)), ("b", other)):
        debug_model.generate(
            speech(1),
            seed=seed,
            style=Style(mixture={"ada": weight}, variation=part),
            fps=fps,
            smoothing=part,
            controls=Controls(energy=part, mirror=mirror),
            cues=[Cue("nod", part)],
        ).save(tmp_path / f"{name}.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert debug_model.stream(look_ahead=np.int64(4), hop=np.int64(2)).latency == pytest.approx(6 / 15, abs=0.2)
    with pytest.raises(UserError, match=r"the seed is 1\.5"):
        debug_model.generate(speech(1), seed=1.5)


CONTROLS = {
    "mirror": {"controls": Controls(mirror=True)},
    "energy": {"controls": Controls(energy=2.0)},
    "extent": {"controls": Controls(extent=0.5)},
    "one hand": {"controls": Controls(handedness="left")},
    "smoothed": {"smoothing": 0.3, "fps": 30},
    "mirror at one frame a second": {"controls": Controls(mirror=True, energy=0.5), "fps": 1},
}


@pytest.mark.parametrize("name", CONTROLS)
def test_a_motion_goes_on_where_the_one_before_ends_whatever_the_controls(debug_model, name):
    """They are in the poses that are given already."""
    options = CONTROLS[name]
    first = debug_model.generate(speech(4), seed=1, **options)
    after = debug_model.generate(speech(3), seed=2, seed_pose=first, **options)
    spec = debug_model.spec
    (given, *_), _ = read_seed_pose(first, spec.skeleton, spec.fps, spec.num_seed_frames)
    np.testing.assert_allclose(after.directions[0], given, atol=1e-3)
