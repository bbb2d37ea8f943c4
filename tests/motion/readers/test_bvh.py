"""Reading BVH: what a file says comes out, however it is written, and no file can do harm."""

import re
import tracemalloc

import numpy as np
import pytest
from motion.readers import bvh_files
from scipy.spatial.transform import Rotation

from ha2g_jax.errors import UserError
from ha2g_jax.motion.readers import bvh as module
from ha2g_jax.motion.readers import bvh_motion
from ha2g_jax.motion.readers.bvh import read_bvh

CHAIN = """HIERARCHY
ROOT base
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT arm
  {
    OFFSET 0 1 0
    CHANNELS 3 Zrotation Yrotation Xrotation
    JOINT hand
    {
      OFFSET 2 0 0
      CHANNELS 3 Zrotation Yrotation Xrotation
      End Site
      {
        OFFSET 1 0 0
      }
    }
  }
}
MOTION
Frames: 3
Frame Time: 0.1
0 0 0 0 0 0 0 0 0 0 0 0
5 0 0 90 0 0 0 0 0 0 0 0
0 0 0 0 0 0 90 0 90 0 0 0
"""


@pytest.fixture
def written(tmp_path):
    """Writes a file and gives its path."""

    def write(content: str | bytes):
        path = tmp_path / "motion.bvh"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def world_motion(bvh, fps):
    """All joints of the file."""
    return bvh_motion.world_motion(bvh, fps, range(len(bvh.joints)))


def test_positions_worked_out_by_hand(written):
    positions, rotations = world_motion(read_bvh(written(CHAIN)), 10)
    np.testing.assert_allclose(positions[0], [[0, 0, 0], [0, 1, 0], [2, 1, 0]], atol=1e-12)
    np.testing.assert_allclose(positions[1], [[5, 0, 0], [4, 0, 0], [4, 2, 0]], atol=1e-12)
    # The arm rotates about z, then about the x it has left: its y points along the world's z.
    np.testing.assert_allclose(positions[2], [[0, 0, 0], [0, 1, 0], [0, 3, 0]], atol=1e-12)
    np.testing.assert_allclose(rotations[1][2] @ [0, 1, 0], [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize("order", ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"])
def test_every_order_of_rotations(order, written):
    joint_angles = bvh_files.swing(0.5, 30)
    bvh = read_bvh(written(bvh_files.bvh(joint_angles, order=order)))
    positions, _ = world_motion(bvh, 30)
    assert bvh.fps == 30 and bvh.seconds == pytest.approx(0.5) and len(positions) == 15
    frame, body = 7, bvh_files.body()

    def place(joint: str) -> tuple[np.ndarray, Rotation]:
        parent, offset = body[joint]
        origin, rotation = place(parent) if parent else (np.zeros(3), Rotation.identity())
        angles = joint_angles[joint][frame, ["XYZ".index(axis) for axis in order]]
        own = Rotation.from_euler(order, angles, degrees=True)
        return origin + rotation.apply(100 * np.array(offset)), rotation * own

    expected = [place(joint)[0] for joint in bvh.joints]
    assert len(expected) == 40
    np.testing.assert_allclose(positions[frame], expected, atol=1e-3)  # the file has six digits


def test_between_frames_bones_keep_their_length(written):
    bvh = read_bvh(written(bvh_files.bvh(bvh_files.swing(2, 30))))
    positions, _ = world_motion(bvh, 17.3)
    children = np.arange(1, len(bvh.joints))
    lengths = np.linalg.norm(positions[:, children] - positions[:, np.array(bvh.parents)[children]], axis=-1)
    np.testing.assert_allclose(lengths, np.broadcast_to(lengths[:1], lengths.shape), rtol=1e-9)
    assert len(positions) == round(len(bvh.motion) / 30 * 17.3)


def test_half_way_is_half_the_angle(written):
    positions, _ = world_motion(read_bvh(written(CHAIN)), 20)
    assert len(positions) == 6  # as long as the file, whose last frame is held
    half = np.sqrt(0.5)
    np.testing.assert_allclose(positions[1, 0], [2.5, 0, 0], atol=1e-12)
    np.testing.assert_allclose(positions[1, 1] - positions[1, 0], [-half, half, 0], atol=1e-12)


FORGIVING = {
    "tabs": lambda text: text.replace(" ", "\t"),
    "carriage returns": lambda text: text.replace("\n", "\r\n"),
    "blanks and empty lines": lambda text: text.replace(" ", "   ").replace("\n", "  \n\n"),
    "upper case": lambda text: re.sub("rotation|position|End Site|Frame Time|Frames", lambda m: m[0].upper(), text),
    "lower case": lambda text: re.sub(
        "ROOT|JOINT|[XYZ](rotat|posit)ion|MOTION|HIERARCHY", lambda m: m[0].lower(), text
    ),
    "byte order mark": lambda text: "\ufeff" + text,
    "braces on the line before": lambda text: re.sub(r"\s*\n\s*{", " {", text),
    "no blank after a colon": lambda text: text.replace(": ", ":"),
    "no line break at the end": lambda text: text.rstrip(),
    "a frame on several lines": lambda text: text.replace("5 0 0 90", "5 0 0\n90"),
    "numbers with exponents": lambda text: text.replace("90", "9.0e+01").replace("Time: 0.1", "Time: +1e-1"),
    "no colons": lambda text: text.replace("Frames:", "Frames").replace("Frame Time:", "Frame Time"),
    "a frame too many": lambda text: text + "1 " * 12,
}


@pytest.mark.parametrize("rewrite", FORGIVING.values(), ids=FORGIVING)
def test_spellings_of_exporters(rewrite, written):
    plain, rewritten = read_bvh(written(CHAIN)), read_bvh(written(rewrite(CHAIN)))
    assert (rewritten.joints, rewritten.parents, rewritten.channels) == (plain.joints, plain.parents, plain.channels)
    assert rewritten.joints == ("base", "arm", "hand") and rewritten.parents == (-1, 0, 1)
    np.testing.assert_array_equal(rewritten.motion, plain.motion)
    np.testing.assert_array_equal(rewritten.offsets, plain.offsets)
    assert rewritten.fps == plain.fps == 10


def test_names_keep_namespaces_and_letters(written):
    text = CHAIN.replace("ROOT base", "ROOT mixamorig:base").replace("JOINT arm", "JOINT linker Arm")
    assert read_bvh(written(text)).joints == ("mixamorig:base", "linker Arm", "hand")
    latin = text.replace("JOINT hand", "JOINT h\xe4nd").encode("latin-1")
    assert read_bvh(written(latin)).joints[2] == "h\\xe4nd"


POSITIONS, ROTATIONS = "Xposition Yposition Zposition", "Zrotation Yrotation Xrotation"
CHANNELS = {
    "positions at every joint": (
        *(f"6 {POSITIONS} {ROTATIONS}", f"6 {POSITIONS} {ROTATIONS}"),
        lambda row: [*row[:6], *"010", *row[6:9], *"200", *row[9:]],
    ),
    "rotations first": (*(f"6 {ROTATIONS} {POSITIONS}", f"3 {ROTATIONS}"), lambda row: [*row[3:6], *row[:3], *row[6:]]),
    "no place": (f"3 {ROTATIONS}", f"3 {ROTATIONS}", lambda row: row[3:]),
}


@pytest.mark.parametrize("case", CHANNELS)
def test_channels_of_exporters(case, written):
    root, others, change = CHANNELS[case]
    head, rows = CHAIN.split("Frame Time: 0.1\n")
    head = head.replace(f"CHANNELS 3 {ROTATIONS}", f"CHANNELS {others}")
    head = head.replace(f"CHANNELS 6 {POSITIONS} {ROTATIONS}", f"CHANNELS {root}", 1)
    rows = [" ".join(change(row.split())) for row in rows.splitlines()]
    positions, rotations = world_motion(read_bvh(written("\n".join([f"{head}Frame Time: 0.1", *rows]))), 10)
    expected, turned = world_motion(read_bvh(written(CHAIN)), 10)
    shift = expected[:, :1] if case == "no place" else 0
    np.testing.assert_allclose(positions, expected - shift, atol=1e-12)
    np.testing.assert_allclose(rotations, turned, atol=1e-12)


def test_a_position_channel_takes_the_offsets_place(written):
    text = CHAIN.replace("CHANNELS 3 Zrotation Yrotation Xrotation\n      End", "CHANNELS 1 Xposition\n      End")
    text = text[: text.index("MOTION")] + "MOTION\nFrames: 1\nFrame Time: 0.1\n0 0 0 0 0 0 0 0 0 3\n"
    positions, _ = world_motion(read_bvh(written(text)), 10)
    np.testing.assert_allclose(positions, [[[0, 0, 0], [0, 1, 0], [3, 1, 0]]])


@pytest.mark.parametrize(
    ("text", "fps"),
    [
        *(("0.033333", 30), ("0.0333333", 30), ("0.033", 30), ("0.008333", 120), ("0.0083", 120), ("0.016666", 60)),
        *(("0.033367", 30 / 1.001), ("0.041708", 24 / 1.001), ("0.01668", 60 / 1.001)),
        *(("0.0167", 60), ("0.017", 60), ("0.0417", 24), ("0.042", 24), ("0.0333", 30)),  # rounded
        *(("0.0125", 80), ("0.05", 20), ("0.04", 25), ("1e-2", 100), ("0.012", 1 / 0.012), ("0.0080000000", 125)),
        *(("0.008", 125), ("0.004", 250)),
    ],
)
def test_a_cut_frame_time_is_the_usual_rate(text, fps, written):
    assert read_bvh(written(CHAIN.replace("Time: 0.1", f"Time: {text}"))).fps == pytest.approx(fps, rel=1e-12)


def test_numbers_across_blocks(written, monkeypatch):
    plain = read_bvh(written(CHAIN)).motion
    for size in (1, 2, 3, 7):
        monkeypatch.setattr(module, "_BLOCK", size)
        np.testing.assert_array_equal(read_bvh(written(CHAIN)).motion, plain)


MANY = "ROOT a {\nOFFSET 0 0 0\n" + "".join(f"JOINT j{i} {{\nOFFSET 0 1 0\nCHANNELS 1 Xrotation\n" for i in range(2000))
WIDE = "".join(f"JOINT w{i} {{\nOFFSET 0 1 0\nCHANNELS 3 Xrotation Yrotation Zrotation\n}}\n" for i in range(100))
HOSTILE = {
    "an image": (b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 40, "does not begin with HIERARCHY"),
    "zeros": (bytes(1 << 20), "line of 65536 characters"),
    "a ring of joints": (CHAIN.replace("JOINT hand", "JOINT base"), "line 11: a second joint 'base'"),
    "thousands of joints": ("HIERARCHY\n" + MANY, "more than 1000 joints"),
    "absurd channels": (CHAIN.replace("CHANNELS 3", "CHANNELS 999999", 1), "CHANNELS '999999', expected 0 to 6"),
    "a long name": (CHAIN.replace("ROOT base", "ROOT " + "base " * 99), "is not followed by {"),
    "nothing moves": (re.sub("CHANNELS.*", "CHANNELS 0", CHAIN), "it has no motion"),
    "a million frames": (CHAIN.replace("Frames: 3", "Frames: 1000000"), "holds 3 whole frames of 12 values"),
    "values beyond memory": (
        CHAIN.replace("JOINT hand", WIDE + "JOINT hand").replace("Frames: 3", "Frames: 2000000"),
        "2000000 frames of 312 channels, expected at most 30,000,000 numbers",
    ),
    "a header without end": (CHAIN.replace("OFFSET 0 0 0", "\n" * (9 << 20)), "characters before the motion"),
    "frames of many digits": (CHAIN.replace("Frames: 3", f"Frames: {'9' * 5000}"), "expected a whole number"),
    "no time": (CHAIN.replace("Time: 0.1", "Time: 0"), "Frame Time: '0'"),
    "cut off": (CHAIN[:-12], "holds 2 whole frames of 12 values, but its header declares 3"),
    "no number": (CHAIN.replace("5 0 0 90", "5 0 nan 90"), "Zposition of base in frame 2 is 'nan'"),
    "a word without end": (CHAIN.replace("5 0 0 90", "1" * (1 << 21)), "a word of more than 65536 characters"),
}


@pytest.mark.parametrize(("content", "found"), HOSTILE.values(), ids=HOSTILE)
def test_a_file_that_cannot_be_used(content, found, written):
    """One line that names the file and what is wrong; memory stays near the file's size."""
    path = written(content)
    tracemalloc.start()
    try:
        with pytest.raises(UserError) as caught:
            read_bvh(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    message = str(caught.value)
    assert found in message and "motion.bvh" in message and "\n" not in message and len(message) < 400
    assert peak < (4 << 20) + 8 * path.stat().st_size
