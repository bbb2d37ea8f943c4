"""A model goes to the Hub and comes back: pinned, checked, without a connection, and never from a damaged copy."""

import json
import pathlib

import numpy as np
import pytest
from fixtures.hub import serve as serve_hub

from ha2g_jax import cli, synthesis
from ha2g_jax.checkpoint import hub, model_folder, publishing, weights
from ha2g_jax.errors import UserError

DEMO = pathlib.Path(model_folder.__file__).parents[1] / "assets" / "demo"


@pytest.fixture
def server(monkeypatch, tmp_path):
    """A Hub on this machine in place of the real one, and an empty cache."""
    pytest.importorskip("huggingface_hub")
    from huggingface_hub import constants

    for name in ("HF_HUB_CACHE", "HUGGINGFACE_HUB_CACHE"):
        monkeypatch.setattr(constants, name, str(tmp_path / "cache"))
    monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
    monkeypatch.setenv("HF_TOKEN", "hf_test")
    with serve_hub() as server:
        monkeypatch.setenv("HF_ENDPOINT", server.address)
        yield server


def publish(name, *, is_private=False):
    return hub.publish(DEMO, "# card", name, is_private=is_private, message="Model")


def test_published_models_are_loaded_by_name_and_commit(server, tmp_path, capsys):
    scores = tmp_path / "scores.md"
    scores.write_text("| beat F1 |\n|---|\n| 0.66 |\n")
    assert cli.main(["publish", "demo", "ada/talker", "--license", "Apache-2.0", "--scores", str(scores)]) == 0
    pinned = capsys.readouterr().out.strip()
    assert pinned == f"hf://ada/talker@{list(server.commits['ada/talker'])[-1]}"
    card = server.find("ada/talker", "main")[1]["README.md"].decode()
    assert card.startswith("---\nlicense: apache-2.0\n") and "| 0.66 |" in card

    first = model_folder.load("hf://ada/talker")
    assert f"hf://ada/talker is {pinned}" in capsys.readouterr().err
    assert model_folder.load(pinned).assets.hash == first.assets.hash == model_folder.load("demo").assets.hash
    assert first.assets.hash in card
    speech = np.random.default_rng(0).normal(0, 0.1, 32000).astype(np.float32)
    expected, found = (synthesis.load(name).generate(speech) for name in ("demo", pinned))
    np.testing.assert_array_equal(found.directions, expected.directions)


def test_the_card_is_of_what_is_published(server, monkeypatch):
    """Large weights are rounded to float16; those of a branch are loaded by its name."""
    monkeypatch.setattr(weights, "_HALF_PRECISION_ABOVE", 1 << 20)
    server.commits["ada/talker"] = {}
    publishing.publish("demo", "hf://ada/talker@paper", "mit")
    files = server.find("ada/talker", "main")[1]
    found = json.loads(files["assets.json"])["hash"]
    assert found != model_folder.load("demo").assets.hash
    card = files["README.md"].decode()
    assert found in card and '("hf://ada/talker@paper")' in card and "# talker\n" in card


def test_nothing_is_published_where_it_was_not_meant_to_be(server):
    with pytest.raises(UserError, match="no access to ada/new@paper"):
        publish("ada/new@paper")
    assert not server.commits
    publish("ada/talker")
    with pytest.raises(UserError, match="ada/talker exists and is public; leave --private out"):
        publish("ada/talker", is_private=True)
    assert len(server.commits["ada/talker"]) == 2  # that which made it, and the model


def test_a_commit_stays_what_it_was_when_the_branch_moves(server):
    pinned = publish("ada/talker")
    server.commit("ada/talker", {"config.json": b"{}"})
    assert (hub.fetch(pinned) / "config.json").read_bytes() == (DEMO / "config.json").read_bytes()
    assert (hub.fetch("hf://ada/talker") / "config.json").read_bytes() == b"{}"


def test_files_that_do_not_belong_together_are_refused(server):
    publish("ada/talker")
    weights = bytearray((DEMO / "model.safetensors").read_bytes())
    weights[-1] ^= 1
    server.commit("ada/talker", {"model.safetensors": bytes(weights)})
    with pytest.raises(UserError, match="belong to two models"):
        model_folder.load("hf://ada/talker")


def test_without_a_connection_the_cache_is_used(server, monkeypatch):
    pinned = publish("ada/talker")
    hub.fetch("hf://ada/talker")
    monkeypatch.setenv("HF_ENDPOINT", "http://127.0.0.1:9")
    assert model_folder.load(pinned).assets.hash == model_folder.load("hf://ada/talker").assets.hash
    with pytest.raises(UserError, match="not in the cache"):
        hub.fetch("hf://ada/other")
    with pytest.raises(UserError, match="hf://ada/other cannot be used"):
        publish("hf://ada/other")


def test_only_the_files_of_a_model_are_fetched_and_none_that_is_too_large(server, monkeypatch):
    server.commits["eve/model"] = {}
    server.commit("eve/model", {"config.json": b"{}", "setup.py": b"1/0", "assets.json": b"{}"})
    with pytest.raises(UserError, match=r"has no model\.safetensors"):
        hub.fetch("hf://eve/model")
    server.commit("eve/model", {"model.safetensors": bytes(1000)})
    assert sorted(path.name for path in hub.fetch("hf://eve/model").iterdir()) == sorted(hub.FILES)
    monkeypatch.setitem(hub.FILES, "model.safetensors", 999)
    server.commit("eve/model", {"model.safetensors": bytes(1001)})
    with pytest.raises(UserError, match="1001 bytes; expected at most 999"):
        hub.fetch("hf://eve/model")
    assert not [request for request in server.requests if "setup.py" in request]


@pytest.mark.parametrize(
    "name", ["hf://", "hf://ada", "hf://ada/../etc", "hf://ada/x/y", "hf://ada/x@", "hf://ada/x@a b", "hf://-a/x"]
)
def test_names_of_another_form_are_refused_before_the_network(name):
    with pytest.raises(UserError, match=r"not the name of a model on the Hub; expected hf://OWNER/NAME or"):
        hub.parse_name(name)


@pytest.mark.parametrize(
    ("name", "licence", "said"),
    [
        ("ada", "mit", "'ada' is not the name of a model on the Hub; expected OWNER/NAME or OWNER/NAME@REVISION"),
        ("ada/x", "", "'' is not the name of a licence; expected one such as apache-2.0 or cc-by-4.0"),
    ],
)
def test_a_mistake_of_publish_is_told_in_the_form_of_its_argument(name, licence, said, capsys):
    assert cli.main(["model", "publish", "demo", name, "--license", licence]) == 2
    assert capsys.readouterr().err.endswith(f"ha2g: {said}\n")
