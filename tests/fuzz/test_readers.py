"""Every reader of files from elsewhere reads any content or refuses it in one line, in little time and memory."""

import functools
import io
import json
import pathlib
import struct
import tempfile
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import soundfile
from fixtures.glb_reader import join_glb, split_glb
from fixtures.motions import swaying
from fixtures.transcripts import DIALECTS, TEXTS, TREES, WORDS, check_words
from fixtures.web_inputs import wav_header
from fuzz import recordings
from fuzz.mutation import FUZZ, damaged_file
from hypothesis import given
from hypothesis import strategies as st
from motion.readers import bvh_files
from PIL import Image

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import read_audio
from ha2g_jax.features.pictures import read_picture
from ha2g_jax.features.words import read_words
from ha2g_jax.importers.ted import arrow
from ha2g_jax.importers.video import extraction, images, overlay, settings
from ha2g_jax.motion.formats import export, keyframes
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import bvh_motion, read_motion
from ha2g_jax.motion.readers.joint_maps import load_map
from ha2g_jax.motion.readers.smplx import read_smplx
from ha2g_jax.motion.readers.smplx_body import template
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.viewer import view

GESTURE = load_skeleton("ted_gesture")
BODY = template()
FRAMES = 6


def look_at_video(path: pathlib.Path) -> None:
    images.image_times(path)
    images.image_size(path)
    images.crops(path, [(0, images.Box(0, 0, 8)), (3, images.Box(-5, 9, 80))], 8)
    extraction.find_shots(path)


def copy_video(path: pathlib.Path) -> None:
    times = images.image_times(path)
    points = np.random.default_rng(0).uniform(0, recordings.SIDE, (len(times), 43, 2))
    overlay.write_overlay(path.with_suffix(".copy.mp4"), path, times, points, np.ones((len(times), 43)))


def consume_motion(path: pathlib.Path) -> None:
    """Read a motion and do with it what the commands do."""
    motion = Motion.load(path)
    motion.save(path.with_name("out.npz"))
    for suffix in (".glb", ".vrma", ".bvh", ".json"):
        export(motion, path.with_name(f"out{suffix}"))
    keyframes.write(path.with_name("out.svg"), motion, count=2, size=64)
    view(motion)


def export_motion(path: pathlib.Path) -> None:
    """Read a motion in any format and write it in others."""
    motion = read_motion(path, source_fps=15)
    motion.save(path.with_name("out.npz"))
    export(motion, path.with_name("x.npz"), rig="smplx")


@functools.cache
def sounds() -> dict[str, bytes]:
    by_soundfile = {f"{kind[1]}.{kind[0]}": recordings.soundfile_bytes(*kind) for kind in recordings.SOUNDFILE_KINDS}
    others = recordings.FFMPEG_SOUND_KINDS + recordings.VIDEO_KINDS
    return by_soundfile | {f"{kind[1]}.{kind[0]}": recordings.ffmpeg_bytes(*kind) for kind in others}


@functools.cache
def videos() -> dict[str, bytes]:
    return {f"{kind[2]}.{kind[0]}": recordings.ffmpeg_bytes(*kind) for kind in recordings.VIDEO_KINDS}


def picture(mode: str, kind: str, **options: object) -> bytes:
    colours = np.random.default_rng(0).integers(0, 256, (8, 8, 3)).repeat(8, 0).repeat(8, 1).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(colours).convert(mode).save(file, kind, **options)
    return file.getvalue()


def pictures() -> dict[str, bytes]:
    return {
        "a.png": picture("RGB", "PNG"),
        "palette.png": picture("P", "PNG"),
        "clear.png": picture("RGBA", "PNG"),
        "progressive.jpg": picture("RGB", "JPEG", progressive=True),
        "print.jpg": picture("CMYK", "JPEG"),
        "a.webp": picture("RGB", "WEBP"),
        "a.gif": picture("P", "GIF"),
        "a.bmp": picture("RGB", "BMP"),
        "a.tga": picture("RGB", "TGA"),
        "lzw.tif": picture("RGB", "TIFF", compression="tiff_lzw"),
        "deflate.tif": picture("CMYK", "TIFF", compression="tiff_deflate"),
        "jpeg.tif": picture("RGB", "TIFF", compression="jpeg"),
    }


def npz(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def motions() -> dict[str, bytes]:
    """A motion with all that its file may hold."""
    motion = swaying(GESTURE.name, FRAMES, size=0.2, speech="a.wav", borders=[2, 4], more={"list": [1, {"x": 0.5}]})
    lower = {
        "lower_offsets": np.full((10, 3), 0.1),
        "lower_rotations": np.tile([0.0, 0.0, 0.0, 1.0], (FRAMES, 9, 1)),
        "lower_translation": np.ones((FRAMES, 3)),
        "face_jaw": np.zeros((FRAMES, 3)),
    }
    names = {"joint_names": np.array(motion.joint_names), "meta": np.array(json.dumps(motion.meta))}
    return {"m.npz": npz(**lower, **names, directions=motion.directions, positions=motion.positions, fps=15.0)}


def plain_motions() -> dict[str, bytes]:
    """Positions alone, as other programs write them, and tables and glTF of ours."""
    motion = swaying(GESTURE.name, FRAMES, size=0.2)
    positions, borders = motion.positions, np.array([2, 4])
    with tempfile.TemporaryDirectory() as folder:
        paths = [pathlib.Path(folder, name) for name in ("x.json", "x.csv", "x.vrma")]
        for path in paths:
            export(motion, path, rig="vrm")
        own = {path.name: path.read_bytes() for path in paths}
    table = {"fps": 15.0, "joint_names": list(GESTURE.joints), "positions": positions.tolist(), "borders": [2, 4]}
    return {
        "m.npz": npz(positions=positions, fps=15.0, joint_names=np.array(GESTURE.joints), borders=borders),
        "m.json": json.dumps(table).encode(),
        **own,
    }


def smplx_files() -> dict[str, bytes]:
    poses = {"poses": np.full((FRAMES, 165), 0.1), "trans": np.ones((FRAMES, 3)), "betas": np.zeros(10)}
    joints = np.tile(BODY.shaped(np.zeros(10))[:55], (FRAMES, 1, 1))
    return {
        "poses.npz": npz(**poses, expressions=np.zeros((FRAMES, 100)), mocap_frame_rate=30.0),
        "joints.npz": npz(joints=joints, fps=30),
    }


def directions() -> dict[str, bytes]:
    file = io.BytesIO()
    np.save(file, swaying(GESTURE.name, FRAMES).directions)
    return {"m.npy": file.getvalue()}


def bvh() -> str:
    return bvh_files.bvh(bvh_files.swing(0.2, 30, with_fingers=False))


MAP = "spine: [Spine3, Chest]\nneck: Neck\nhead: Head\nleft_shoulder: LeftArm\nunit: 0.01\nup: y\n"
JOINT_MAPS = {
    "a.yaml": MAP.encode(),
    "a.json": json.dumps({"spine": ["Spine3", "Chest"], "neck": "Neck", "unit": 0.01, "up": "y"}).encode(),
}
TRANSCRIPTS = {
    name: (content if isinstance(content, str) else json.dumps(content)).encode()
    for name, content in (TEXTS | TREES | {name: write(WORDS) for name, write in DIALECTS.items()}).items()
}
TED_VALUE = pathlib.Path(__file__).parents[1] / "importers" / "ted" / "pyarrow_0_14_values.bin"
READERS: dict[str, tuple[Callable[[pathlib.Path], object], Callable[[], dict[str, bytes]]]] = {
    "sound": (read_audio, sounds),
    "picture": (read_picture, pictures),
    "video": (look_at_video, videos),
    "copy of a video": (copy_video, videos),
    "transcript": (lambda path: check_words(read_words(path)), lambda: TRANSCRIPTS),
    "settings": (settings.read_settings, lambda: {"a.json": json.dumps(settings.VideoSettings().as_json()).encode()}),
    "joint map": (lambda path: load_map(str(path)), lambda: JOINT_MAPS),
    "BVH": (lambda path: bvh_motion.read_motion(path, GESTURE, fps=15), lambda: {"a.bvh": bvh().encode()}),
    "SMPL-X": (lambda path: read_smplx(path, GESTURE, BODY, fps=15), smplx_files),
    "SMPL-X to another": (export_motion, smplx_files),
    "directions": (export_motion, directions),
    "motion": (consume_motion, motions),
    "motion to score": (lambda path: read_motion(path, skeleton=GESTURE.name, fps=15), plain_motions),
    "value of TED": (lambda path: arrow.deserialize(path.read_bytes(), "x"), lambda: {"x": TED_VALUE.read_bytes()}),
}


@pytest.mark.parametrize("kind", READERS)
def test_the_files_to_damage_are_read(kind, tmp_path):
    read, files = READERS[kind]
    for name, content in files().items():
        (tmp_path / name).write_bytes(content)
        read(tmp_path / name)


@FUZZ
@given(data=st.data())
@pytest.mark.parametrize("kind", READERS)
def test_a_damaged_file(answered, capfd, kind, data):
    """Nothing is printed either, as libraries in C do."""
    read, files = READERS[kind]
    name = data.draw(st.sampled_from(sorted(files())))
    answered(read, data.draw(damaged_file(name, files()[name])), name)
    assert capfd.readouterr() == ("", "")


def wav(data: bytes, **stated: int) -> bytes:
    """Return a WAV of 16 bits whose header says anything."""
    return wav_header(**({"size": len(data)} | stated)) + data


def rf64(num_bytes: int) -> bytes:
    """Return a RF64 of a second that declares `num_bytes`."""
    sizes = struct.pack("<IQQQI", 28, num_bytes, num_bytes, num_bytes // 2, 0)
    return b"RF64" + b"\xff" * 4 + b"WAVEds64" + sizes + wav(bytes(32_000), size=2**32 - 1)[12:]


def flac(rate: int, seconds: int, declared: int) -> bytes:
    """Return silence with another number of samples in its header."""
    file = io.BytesIO()
    soundfile.write(file, np.zeros(rate * seconds, np.int16), rate, format="FLAC")
    content = bytearray(file.getvalue())
    content[21] = content[21] & 0xF0 | declared >> 32
    content[22:26] = struct.pack(">I", declared % 2**32)
    return bytes(content)


def png(side: int) -> bytes:
    """Return a PNG that states any size."""
    content = bytearray(picture("RGB", "PNG"))
    struct.pack_into(">2I", content, 16, side, side)
    struct.pack_into(">I", content, 29, zlib.crc32(content[12:29]))
    return bytes(content)


def many_passes() -> bytes:
    """Return a progressive JPEG whose last pass over its 4,096 x 4,096 pixels comes a thousand times."""
    file = io.BytesIO()
    Image.new("L", (4096, 4096)).save(file, "JPEG", progressive=True)
    content = file.getvalue()
    last = content[content.rindex(b"\xff\xda") : -2]
    return content[:-2] + 1_000 * last + content[-2:]


def large_tile() -> bytes:
    """Return a TIFF of 64 x 64 whose one tile is of 60,000 x 60,000."""
    tags = {256: 64, 257: 64, 258: 8, 259: 8, 262: 1, 277: 1, 322: 60_000, 323: 60_000, 324: 200, 325: 100}
    fields = b"".join(struct.pack("<2H2I", tag, 4, 1, value) for tag, value in tags.items())
    head = struct.pack("<2sHIH", b"II", 42, 8, len(tags))
    return head + fields + bytes(4) + zlib.compress(bytes(10_000)) + bytes(200)


def large_video() -> bytes:
    """Return an AVI whose header states images of 2 G x 2 G."""
    content, size = recordings.ffmpeg_bytes("avi", "pcm_s16le", "mpeg4"), struct.pack("<2i", *2 * [recordings.SIDE])
    assert size in content
    return content.replace(size, struct.pack("<2i", 2**31 - 1, 2**31 - 1))


def chain() -> bytes:
    """Return a BVH with a thousand joints one below the other."""
    channels = "OFFSET 0 1 0\nCHANNELS 3 Xrotation Yrotation Zrotation\n"
    joints = [f"{'JOINT' if number else 'ROOT'} j{number}\n{{\n{channels}" for number in range(1000)]
    motion = f"MOTION\nFrames: 1\nFrame Time: 0.03333\n{'0 ' * 3000}"
    return f"HIERARCHY\n{''.join(joints)}{'}' * 1000}\n{motion}".encode()


def far_keys(fps: float) -> bytes:
    """Return a glTF of a few keys whose last is two hours after the others, at any frame rate."""
    tree, blob = split_glb(plain_motions()["x.vrma"])
    tree["scenes"][0]["extras"]["fps"] = fps
    start = 4 * (FRAMES - 1)  # of the last time
    return join_glb(tree, blob[:start] + struct.pack("<f", 7_200) + blob[start + 4 :])


def many_tracks() -> bytes:
    """Return a glTF whose thousands of tracks are one array of half a million keys."""
    tree, blob = split_glb(plain_motions()["x.vrma"])
    clip, keys = tree["animations"][0], 1 << 19
    for kind, width, data in (
        ("SCALAR", 1, np.arange(keys, dtype="<f4") / 1000),
        ("VEC4", 4, np.zeros(4 * keys, "<f4")),
    ):
        tree["bufferViews"].append({"buffer": 0, "byteOffset": len(blob), "byteLength": 4 * width * keys})
        view = len(tree["bufferViews"]) - 1
        tree["accessors"].append({"bufferView": view, "componentType": 5126, "count": keys, "type": kind})
        blob += data.tobytes()
    last = len(tree["accessors"]) - 1
    clip["samplers"] = [sampler | {"input": last - 1, "output": last} for sampler in clip["samplers"]]
    clip["channels"] *= 1_000
    return join_glb(tree, blob)


def laughs() -> bytes:
    """Return a map that unfolds to 8^30 names."""
    rows = "".join(f"a{number}: &a{number} [{f'*a{number - 1}, ' * 8}]\n" for number in range(1, 30))
    return f"a0: &a0 [x, x, x, x, x, x, x, x]\n{rows}up: *a29".encode()


PLAYLIST = b"#EXTM3U\n#EXTINF:9,\nhttp://127.0.0.1:9/a.ts\n#EXT-X-ENDLIST\n"
CUE = b"1\n00:00:01,000 --> 00:00:02,000\n"
DEEP = b'{"a":' * 200_000 + b"1" + b"}" * 200_000
# Small files that would take hours, all memory or a connection: reader, name, content, and what the refusal says.
BOMBS: dict[str, tuple[str, str, Callable[[], bytes], str]] = {
    "hours in the header": ("sound", "a.flac", lambda: flac(16_000, 1, 2**36 - 1), "more than 65 min"),
    "no stated length": ("sound", "a.flac", lambda: flac(1_000, 5_400, 0), "more than 65 min"),
    "65,535 channels": ("sound", "a.wav", lambda: wav(bytes(80_000), channels=65_535), "channels"),
    "a rate of 2 GHz": ("sound", "a.wav", lambda: wav(bytes(16_000), rate=2**31 - 1), "2147483647 samples per second"),
    "addresses": ("sound", "a.wav", lambda: PLAYLIST, "no sound"),
    "files": ("sound", "a.wav", lambda: b"ffconcat version 1.0\nfile '/etc/passwd'\n", "no sound that can be read"),
    "30,000 x 30,000": ("picture", "a.png", lambda: png(30_000), "exceeds limit"),
    "10,000 x 10,000": ("picture", "a.png", lambda: png(10_000), "more than 67108864 pixels"),
    "a thousand passes": ("picture", "a.jpg", many_passes, "passes"),
    "a large tile": ("picture", "a.tif", large_tile, "60000 x 60000, which is more than 67108864 pixels"),
    "a program": ("picture", "a.eps", lambda: b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", "is no image"),
    "lines": ("transcript", "a.srt", lambda: CUE + b"a\n" * 4_000_000, "more than 1000000 lines"),
    "letters": ("transcript", "a.srt", lambda: CUE + b"a" * (4 << 20), "expected at most 3145728"),
    "words": ("transcript", "a.tsv", lambda: b"".join(b"%d\t%d\ta\n" % (i, i) for i in range(110_000)), "100000 words"),
    "laughs": ("joint map", "a.yaml", laughs, "an alias"),
    "digits": ("joint map", "a.yaml", lambda: b"spine: 0x" + b"f" * 60_000, "more than 200 characters"),
    "a chain": ("BVH", "a.bvh", chain, "fits no known joint map"),
    "deep transcript": ("transcript", "a.json", lambda: DEEP, "nested too deep"),
    "deep settings": ("settings", "a.json", lambda: DEEP, "a.json"),
    "deep map": ("joint map", "a.yaml", lambda: b"[" * 30_000, "nested too deep"),
    "far keys": ("motion to score", "x.glb", lambda: far_keys(1000.0), "frames of .* joints; cut the file"),
    "many tracks": ("motion to score", "x.glb", many_tracks, "more than 30,000,000 numbers in its animations"),
    "deep motion": ("motion to score", "m.json", lambda: DEEP, "nested too deep"),
}  # fmt: skip


@pytest.mark.parametrize("case", BOMBS)
def test_a_small_file_that_unfolds_is_refused(answered, case):
    kind, name, make, message = BOMBS[case]

    def read(path: pathlib.Path) -> None:
        with pytest.raises(UserError, match=message):
            READERS[kind][0](path)

    answered(read, make(), name)


def test_a_header_that_promises_more_than_there_is_does_not_matter(tmp_path):
    for content in (rf64(2**60), wav(bytes(32_000), size=2**32 - 1)):
        (tmp_path / "speech.wav").write_bytes(content)
        assert len(read_audio(tmp_path / "speech.wav")) == 16_000


def test_marks_without_end_are_read(answered):
    """Marks on one letter are sorted in the square of their number, a minute for these."""
    answered(read_words, CUE + ("a" + "\u0301\u0327" * 100_000).encode(), "a.srt")


def test_a_size_in_the_header_of_a_video_takes_no_memory(answered):
    answered(look_at_video, large_video(), "a.avi")


def test_eight_channels_are_read_by_ffmpeg(tmp_path):
    """PyAV's own conversion of such frames to arrays ends the process."""
    (tmp_path / "film.mka").write_bytes(recordings.ffmpeg_bytes("matroska", "flac", "", "7.1"))
    assert np.abs(read_audio(tmp_path / "film.mka")).max() == pytest.approx(0.35, abs=0.05)


@pytest.mark.parametrize("name", ["sp\udcff\udce9ech.wav", "12:30.wav", "-x\u202e\n.wav"])
def test_a_file_of_any_name_is_read(tmp_path, name):
    """By libsndfile and by FFmpeg, which takes a colon for that of a protocol."""
    for content in (recordings.soundfile_bytes("WAV", "PCM_16"), recordings.ffmpeg_bytes("ipod", "aac", "")):
        (tmp_path / name).write_bytes(content)
        assert len(read_audio(tmp_path / name)) >= 4_000


@pytest.mark.parametrize("kind", ["PNG", "TIFF"])
def test_16_bits_are_as_bright_as_8(tmp_path, kind):
    grey = np.arange(4096, dtype=np.uint16).reshape(64, 64) // 16
    Image.fromarray(grey * 257).save(tmp_path / "deep", kind)
    np.testing.assert_array_equal(np.asarray(read_picture(tmp_path / "deep"))[..., 0], grey)
