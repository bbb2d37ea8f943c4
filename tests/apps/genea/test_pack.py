"""A pack has five samples of each clip under its name, says how each was made, and is whole or not there."""

import hashlib
import json
import pathlib
import zipfile
from typing import Any

import numpy as np
import pytest
from apps.genea.conftest import FRAMES

from ha2g_jax import cli
from ha2g_jax.apps.genea import pack as packs
from ha2g_jax.apps.genea.pack import check_pack, write_pack
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.motion_folders import from_folders

FILES = {f"sample_{number}/{clip}.npz" for number in range(1, 6) for clip in FRAMES}


def files_of(folder: pathlib.Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_numpy_alone_finds_a_pack_as_the_rules_ask(written):
    """Nothing of this program reads the files here."""
    paths = sorted(written.glob("*/*.npz"))
    assert {path.relative_to(written).as_posix() for path in paths} == FILES
    motions = {}
    for path in paths:
        with np.load(path, allow_pickle=False) as found:
            arrays = dict(found)
        frames = FRAMES[path.stem]
        shapes = {name: arrays[name].shape for name in ("betas", "poses", "expressions", "trans")}
        assert shapes == {"betas": (300,), "poses": (frames, 165), "expressions": (frames, 100), "trans": (frames, 3)}
        assert arrays["mocap_frame_rate"] == 30 and arrays["model"] == "smplx2020"
        assert np.isfinite(arrays["poses"]).all() and np.ptp(arrays["poses"], axis=0).max() > 0.01
        motions.setdefault(path.stem, set()).add(arrays["poses"].tobytes())
    assert {clip: len(found) for clip, found in motions.items()} == dict.fromkeys(FRAMES, 5)
    assert check_pack(written).findings == []


def test_the_manifest_has_seeds_and_hashes(written, speech, debug_model):
    manifest = json.loads((written / "manifest.json").read_text())
    assert manifest["checkpoint"] and manifest["fps"] == 30
    for clip, facts in manifest["clips"].items():
        assert facts["speech"]["sha256"] == hashlib.sha256((speech / f"{clip}.wav").read_bytes()).hexdigest()
        assert [each["seed"] for each in facts["samples"]] == [7, 8, 9, 10, 11]
        for each in facts["samples"]:
            assert each["sha256"] == hashlib.sha256((written / each["file"]).read_bytes()).hexdigest()


def test_a_sample_is_what_generate_makes_with_its_seed(written, speech, checkpoint, tmp_path):
    command = ["generate", str(speech / "1_wayne_0_1_1.wav"), "--checkpoint", str(checkpoint), "--seed", "8"]
    assert cli.main([*command, "--fps", "30", "-o", str(tmp_path / "x.npz")]) == 0
    assert cli.main(["export", str(tmp_path / "x.npz"), "--rig", "smplx", "-o", str(tmp_path / "y.npz")]) == 0
    with np.load(tmp_path / "y.npz") as ours, np.load(written / "sample_2" / "1_wayne_0_1_1.npz") as packed:
        np.testing.assert_allclose(packed["poses"], ours["poses"], atol=1e-6)


def test_the_same_arguments_give_the_same_zip(written, speech, checkpoint, tmp_path):
    for name in ("a.zip", "b.zip"):
        write_pack(speech, tmp_path / name, checkpoint=checkpoint, seed=7, samples=5)
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert archive.testzip() is None
        assert {name: archive.read(name) for name in archive.namelist()} == files_of(written)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.zip", "b.zip"]


def test_a_clip_of_beat2_moves_as_its_speaker_where_the_model_has_them(
    debug_model, speech, checkpoint, tmp_path, monkeypatch
):
    from ha2g_jax.synthesis import files as generation

    model = generation.load(checkpoint)
    [first, *_] = model.assets.speakers.values()
    model.assets.speakers["scott"] = first
    monkeypatch.setattr(generation, "load", lambda *_: model)
    write_pack(speech, tmp_path / "pack", samples=1)
    manifest = json.loads((tmp_path / "pack" / "manifest.json").read_text())
    kinds = {clip: facts["samples"][0]["style"]["kind"] for clip, facts in manifest["clips"].items()}
    assert kinds == {"1_wayne_0_1_1": "random", "2_scott_0_3_3": "speaker"}


@pytest.mark.parametrize("layout", ["{clip}.{number}.npz", "sample_{number}/{clip}.npz"])
def test_motion_of_another_system_is_packed(layout, speech, files, tmp_path):
    with np.load(files["BEAT2"]) as given:
        arrays: dict[str, Any] = {name: given[name] for name in ("trans", "poses", "mocap_frame_rate")} | {
            "betas": np.full(300, 0.1)
        }
    for clip, frames in FRAMES.items():
        for number in range(1, 6):
            path = tmp_path / "theirs" / layout.format(clip=clip, number=number)
            path.parent.mkdir(parents=True, exist_ok=True)
            repeated: dict[str, Any] = {
                name: np.resize(arrays[name], (frames, width)) for name, width in (("trans", 3), ("poses", 165))
            }
            repeated["poses"][:, 60:] *= number / 5
            np.savez(path, **arrays | repeated)
    pack = write_pack(speech, tmp_path / "pack.zip", motion=tmp_path / "theirs")
    assert check_pack(pack, speech).findings == []
    with zipfile.ZipFile(pack) as archive, archive.open("sample_3/2_scott_0_3_3.npz") as file, np.load(file) as found:
        np.testing.assert_array_equal(found["betas"], np.full(300, 0.1, np.float32))
        expected = np.resize(arrays["poses"], (90, 165))[:, 60:] * 3 / 5
        np.testing.assert_array_equal(found["poses"][:, 60:], expected.astype(np.float32))
    with pytest.raises(UserError, match=r"theirs has 5 motions of 1_wayne_0_1_1; expected 3 of each of the 2 clips"):
        write_pack(speech, tmp_path / "other", motion=tmp_path / "theirs", samples=3)


def test_motion_of_any_kind_is_packed(speech, files, tmp_path):
    (tmp_path / "theirs").mkdir()
    for clip in FRAMES:
        (tmp_path / "theirs" / f"{clip}.bvh").write_text(files["GENEA BVH"].read_text())
    pack = write_pack(speech, tmp_path / "pack", motion=tmp_path / "theirs")
    verdict = check_pack(pack, speech)
    assert verdict.findings == []
    assert verdict.notes == ["one sample of each clip, as of a system without randomness; others need 5"]


def test_shapes_are_those_of_the_speakers(speech, checkpoint, tmp_path):
    (tmp_path / "beat2").mkdir()
    for speaker, value in (("1_wayne", 0.1), ("2_scott", 0.2)):
        np.savez(tmp_path / "beat2" / f"{speaker}_0_9_9.npz", betas=np.full(300, value))
    pack = write_pack(speech, tmp_path / "pack", checkpoint=checkpoint, samples=1, shapes=tmp_path / "beat2")
    for clip, value in (("1_wayne_0_1_1", 0.1), ("2_scott_0_3_3", 0.2)):
        with np.load(pack / "sample_1" / f"{clip}.npz") as found:
            np.testing.assert_allclose(found["betas"], np.full(300, value), rtol=1e-6)
    (tmp_path / "beat2" / "2_scott_0_9_9.npz").unlink()
    with pytest.raises(UserError, match="has no file of 2_scott_0_3_3 or its speaker"):
        write_pack(speech, tmp_path / "other", checkpoint=checkpoint, shapes=tmp_path / "beat2")


def test_a_pack_that_is_not_finished_leaves_nothing(speech, checkpoint, tmp_path, monkeypatch):
    def stop(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(packs, "hash_of", stop)
    for name in ("pack", "pack.zip"):
        with pytest.raises(KeyboardInterrupt):
            write_pack(speech, tmp_path / name, checkpoint=checkpoint)
        assert list(tmp_path.iterdir()) == []


def test_a_folder_that_exists_stays(speech, checkpoint, tmp_path, capsys):
    assert cli.main(["genea", "pack", str(speech), "-o", str(tmp_path), "--checkpoint", str(checkpoint)]) == 2
    assert capsys.readouterr().err.endswith("exists; choose another name or remove it\n")
    given = ["genea", "pack", str(speech), "-o", str(tmp_path / "x"), "--motion", str(tmp_path), "--seed", "1"]
    assert cli.main(given) == 2
    assert "--motion packs what is there" in capsys.readouterr().err


def test_evaluate_takes_a_pack_as_five_motions_of_each_clip(written, tmp_path):
    reference = tmp_path / "true"
    reference.mkdir()
    for clip in FRAMES:
        (reference / f"{clip}.npz").write_bytes((written / "sample_1" / f"{clip}.npz").read_bytes())
    folders = from_folders(written, reference)
    assert [clip.id for clip in folders.motion].count("2_scott_0_3_3") == 5
    assert len(folders.motion) == 10 and len(folders.reference) == 2
    assert not any("no counterpart" in note for note in folders.notes)
