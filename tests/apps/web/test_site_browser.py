"""The site in a real Chromium: motion is that of Python, nothing leaves the page, and it goes on after any bad file.

It needs node, npm with its registry, chromium, playwright-core and axe-core, which node finds in NODE_PATH or
node_modules; it is skipped without them. The pictures that it takes stay in the test's temporary folder.
"""

import base64
import pathlib
import shutil

import av
import numpy as np
import pygltflib
import pytest
import soundfile
import soxr
from fixtures.browser import drive
from fixtures.web_inputs import WICKED, write_avatar, write_bad, write_stopped

from ha2g_jax.apps.web import site as builder
from ha2g_jax.motion.control import Controls
from ha2g_jax.motion.motion import Motion
from ha2g_jax.synthesis import Style, load_onnx

EXAMPLE = pathlib.Path(__file__).parents[3] / "examples" / "hello.wav"
MIXTURE = {"speaker-01": 0.75, "speaker-03": 0.25}


@pytest.fixture(scope="module")
def seen(site, tmp_path_factory):
    """What the script saw; `folder` is where its pictures and files are."""
    folder = tmp_path_factory.mktemp("visit")
    shutil.copytree(site, folder / "site")
    shutil.copytree(site, folder / "newer")
    page, worker = folder / "newer" / "index.html", folder / "newer" / "sw.js"
    page.write_text(page.read_text().replace("<title>Speech to gestures", "<title>Newer"))
    worker.write_text(worker.read_text().replace(builder.integrity_of(site / "index.html"), builder.integrity_of(page)))
    model = (site / "model" / "model.onnx").read_bytes()
    (folder / "cut.onnx").write_bytes(model[: len(model) // 2])
    write_speech(folder / "speech.wav", folder / "speech.mp3")
    write_avatar(folder / "wicked.vrm")
    shutil.copy(folder / "wicked.vrm", folder / "avatar.glb")
    write_stopped(folder / "stopped.wav")
    (folder / "bad").mkdir()
    write_bad(folder / "bad")
    found = drive(pathlib.Path(__file__).with_name("drive_site.cjs"), folder, needs=["axe-core"])
    return {**found, "folder": folder}


def write_speech(wav, mp3):
    """Write the example in stereo at 44.1 kHz, so that the page has to mix and to resample it."""
    samples, rate = soundfile.read(EXAMPLE, dtype="float32")
    stereo = np.stack([soxr.resample(samples, rate, 44100)] * 2, axis=1)
    soundfile.write(wav, stereo, 44100, "PCM_16")
    soundfile.write(mp3, stereo, 44100)


@pytest.fixture(scope="module")
def expected(seen, site):
    """The two motions of Python: of a random style, and of a mixture, another take and more energy."""
    model, path = load_onnx(site / "model" / "model.onnx"), seen["folder"] / "speech.wav"
    style, controls = Style(mixture=MIXTURE), Controls(energy=1.4)
    return {"first": model.generate(path), "second": model.generate(path, style=style, seed=7, controls=controls)}


def angles(seen, name, expected):
    """Angles in degrees between the directions that the page had and those of Python."""
    found = np.frombuffer(base64.b64decode(seen[name]), "<f4").reshape(expected.directions.shape)
    cross = np.linalg.norm(np.cross(found, expected.directions), axis=-1)
    return np.degrees(np.arctan2(cross, np.sum(found * expected.directions, -1)))


@pytest.mark.parametrize("name", ["first", "second"])
def test_the_motion_is_that_of_python_with_its_style_take_and_energy(seen, expected, name):
    found = angles(seen, name, expected[name])
    assert np.median(found) < 0.5 and found.max() < 2
    assert angles(seen, "first", expected["second"]).max() > 10  # or else the comparison shows nothing


def test_it_is_five_times_as_fast_as_the_sound(seen):
    assert float(seen["spoken"].split()[-4]) >= 5
    assert seen["liveFactor"] > 1


def test_it_is_there_soon_and_small(seen, site):
    files = [path for path in site.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 25e6
    assert seen["loadSeconds"] < 10  # 1.2 s on an idle computer
    assert seen["hello"].startswith("Choose a sound file")


def test_the_figure_shows_the_time_of_the_sound(seen):
    shown = np.array(seen["shown"])
    assert np.abs(shown[:, 0] - shown[:, 1]).max() < 1
    assert np.ptp(shown[:, 1]) > 0.5


def test_nothing_is_asked_of_another_origin(seen):
    assert len(seen["requests"]) > 50
    inside = (f"{seen['origin']}/some/path/", "blob:", "data:")
    assert [request for request in seen["requests"] if not request.startswith(inside)] == []
    assert seen["errors"] == []


def test_files_are_those_of_python(seen, expected):
    expected = expected["second"]
    saved = seen["folder"] / "saved"
    assert seen["saved"] == ["speech.npz", "speech.bvh", "speech.glb", "speech.webm"]
    motion = Motion.load(saved / "speech.npz")
    np.testing.assert_array_equal(motion.directions.astype("<f4").tobytes(), base64.b64decode(seen["second"]))
    assert motion.fps == expected.fps
    assert f"Frames: {expected.num_frames}" in (saved / "speech.bvh").read_text()
    scene = pygltflib.GLTF2().load(saved / "speech.glb")
    assert scene is not None and scene.animations
    with av.open(str(saved / "speech.webm"), "r") as video:
        (images,), (sound,) = video.streams.video, video.streams.audio
        times = [float(frame.time) for frame in video.decode(images)]
        assert images.width % 2 == images.height % 2 == 0
        assert sound.codec_context.sample_rate == 48000
    assert times[-1] == pytest.approx(expected.num_frames / expected.fps, abs=0.7)


def test_compressed_sound_is_read(seen):
    assert "s of gestures" in seen["compressed"]


def test_bad_files_end_in_a_sentence_and_the_page_goes_on(seen):
    assert len(seen["bad"]) == 9
    for name, text in seen["bad"].items():
        assert name in text
        assert text.endswith(".")
    assert "512 MiB" in seen["bad"]["huge.wav"]
    assert "60 minutes" in seen["bad"]["hour.wav"]
    assert "s of gestures" in seen["goesOn"]
    assert "2.0 s of gestures" in seen["stopped"]
    assert seen["imagesOfBad"] == 0


def test_a_model_that_is_cut_short_can_be_loaded_again(seen):
    assert seen["cutModel"].startswith("The model cannot be loaded")
    assert "s of gestures" in seen["afterCutModel"]


def test_an_avatar_moves_and_its_texts_are_texts(seen):
    assert WICKED[:40] in seen["avatar"]
    assert seen["images"] == 0
    assert seen["avatarDrawn"] and seen["figureDrawn"]
    assert WICKED[:40] in seen["avatarByAnyName"]


def test_what_is_asked_for_last_is_what_is_shown(seen):
    assert seen["lastAsked"] == "speech.wav"
    assert seen["lastTake"] == "99"


def test_a_video_shows_one_figure_and_every_image(seen):
    assert "when the video is saved" in seen["avatarKept"]
    assert "No video was saved" in seen["hiddenVideo"]


def test_the_microphone_is_followed_and_recorded(seen):
    assert seen["listening"].startswith("Listening")
    assert seen["state"] == "think"
    assert "latency 667 +" in seen["facts"]  # 8 + 2 frames
    frames, seconds = seen["recorded"]
    assert frames == pytest.approx(15 * seconds, abs=1)
    assert seconds > 2.5
    assert "may not be used" in seen["denied"]
    assert "stays" in seen["anotherOfARecording"]


def test_a_recording_is_kept_when_the_microphone_ends(seen):
    assert seen["unplugged"] == [45, 3]
    assert seen["unpluggedStatus"] == "The microphone is gone."


def test_keys_suffice(seen):
    assert seen["startsStill"]
    assert seen["byKeys"] == "hello.bvh"
    assert [name for name, is_visible in seen["focused"] if not is_visible and name != "BODY"] == []


def test_it_works_offline_and_takes_a_new_version(seen, site):
    assert "s of gestures" in seen["offline"]
    assert seen["oldTitle"] == "Speech to gestures"
    kept, other_caches = seen["kept"]
    assert kept == sum(path.is_file() for path in site.rglob("*")) - 2  # without sw.js and site.json
    assert other_caches == 0


def test_axe_finds_nothing_serious(seen):
    assert len(seen["faults"]) == 5
    for name, faults in seen["faults"].items():
        assert [fault for fault in faults if fault[0] in ("serious", "critical")] == [], (name, faults)


def test_everything_fits_on_phones_and_desktops(seen):
    assert {name: sizes for name, sizes in seen["overflow"].items() if max(sizes) > 0} == {}


def test_in_small_windows_the_figure_is_seen_and_every_button_is_reached(seen):
    assert len(seen["small"]) == 4
    for height, reaches, overflow in seen["small"].values():
        assert height >= 150 and reaches and overflow <= 0


def test_ten_minutes_live_take_no_more_memory(seen):
    heap, resident = np.array(seen["memory"]).T
    assert len(heap) == 10
    assert seen["liveFrames"] == pytest.approx(9000, abs=20)
    assert heap[-1] - heap[0] < 2
    assert resident[-1] - resident[1] < 30
