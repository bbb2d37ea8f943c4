"""The PyTorch step that benchmarks compare with has our parameters, outputs, losses and gradients."""

import functools
import importlib
import pathlib

import jax
import numpy as np
import pytest

from ha2g_jax.config import presets
from ha2g_jax.errors import UserError
from ha2g_jax.methods import method_of
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.train.objective import build_objective, init_state
from ha2g_jax.train.step import step_keys, train_step

pytestmark = pytest.mark.torch


@pytest.fixture(scope="module")
def torch():
    return pytest.importorskip("torch")


@pytest.fixture(scope="module")
def torch_peer(torch):
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(pathlib.Path(__file__).parents[2] / "benchmarks"))
        yield importlib.import_module("torch_peer")


@pytest.fixture
def config():
    """TED-Expressive at debug size with a coarse and the finest level, without dropout."""
    config = presets.sized("ted_expressive", "debug")
    config.model.identity.kind = "speakers"
    config.model.inferer.levels = (1, 6)
    config.model.inferer.layers = 2
    config.model.text.dropout = 0.0
    return config


def _objective(config):
    return build_objective(config, load_skeleton(config.skeleton), 11, 5)


def _copy(torch, network, variables):
    """Copy the variables of one of our networks to a module that has the same names."""
    tensors = dict(network.state_dict())
    names = {"kernel": "weight", "scale": "weight", "embedding": "weight"}
    names |= {"mean": "running_mean", "variance": "running_var"}
    for path, array in jax.tree.leaves_with_path([variables["params"], variables["batch_stats"]]):
        *parents, name = (key.key for key in path[1:])
        module, array = ".".join(parents), np.asarray(array)
        if f"{module}.parametrizations.weight.original0" in tensors and name != "bias":
            name = f"parametrizations.weight.original{int(name == 'kernel')}"
        target = tensors.pop(f"{module}.{names.get(name, name)}")
        if array.ndim > 1 and path[-1].key == "kernel":
            array = np.moveaxis(array, (-1, -2), (0, 1))
        with torch.no_grad():
            target.copy_(torch.from_numpy(array.reshape(target.shape).copy()))
    assert all(name.endswith("num_batches_tracked") for name in tensors)


def _norm(network):
    return np.sqrt(sum(float(parameter.grad.square().sum()) for parameter in network.parameters()))


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"text.receptive_field": "causal", "text.layers": 2, "inferer.coordinator": "tied"},
        {"identity.kind": "images"},
    ],
)
def test_has_as_many_parameters_as_ours(torch_peer, config, changes):
    config.model.update_from_flattened_dict(changes)
    objective = _objective(config)
    state = jax.eval_shape(functools.partial(init_state, objective), jax.random.key(0))
    theirs = torch_peer.TorchStep(config, objective)
    for name in ("generator", "discriminator"):
        ours = sum(leaf.size for leaf in jax.tree.leaves(getattr(state, name).params))
        assert sum(parameter.numel() for parameter in getattr(theirs, name).parameters()) == ours, name


@pytest.mark.parametrize("kind", ["speakers", "images"])
def test_outputs_in_evaluation_mode_are_ours(torch, torch_peer, config, draw_state, make_batch, kind):
    config.model.identity.kind = kind
    objective = _objective(config)
    spec, state, batch = objective.spec, draw_state(objective), make_batch(objective, 2)
    keys = step_keys(spec, jax.random.key(0), state.step)
    run = jax.jit(lambda variables, batch: method_of(spec).run(spec, variables, batch, keys, train=False).outputs)
    outputs = run(state.generator.variables, batch)

    step = torch_peer.TorchStep(config, objective)
    _copy(torch, step.generator, state.generator.variables)
    step.generator.eval()
    tensors = step.tensors(batch)
    with torch.no_grad():
        features, text, (mean, log_variance) = step.generator.encode(
            tensors["mel"], tensors["words"], tensors[spec.identity]
        )
        seed = tensors["directions"].flatten(2) - torch.tensor(spec.skeleton.mean_directions).flatten()
        poses = step.generator.infer(features, mean, seed[:, : spec.num_seed_frames])
    theirs = (tuple(poses), features, text, mean, log_variance)
    for a, b in zip(jax.tree.leaves(tuple(outputs)), jax.tree.leaves(theirs), strict=True):
        np.testing.assert_allclose(a, b.numpy(), rtol=1e-4, atol=1e-4)


def test_a_step_has_our_losses_and_gradients(torch, torch_peer, config, draw_state, make_batch):
    objective = _objective(config)
    state, batch = draw_state(objective), make_batch(objective, 2)  # of two clips each has the identity of the other
    heads = state.generator.params["identity"]  # identities of no variance, so that none is drawn
    heads["log_variance"] = {"kernel": np.zeros((18, 18), np.float32), "bias": np.full(18, -40, np.float32)}
    step = torch_peer.TorchStep(config, objective)
    _copy(torch, step.generator, state.generator.variables)
    _copy(torch, step.discriminator, state.discriminator.variables)
    after, metrics = jax.jit(functools.partial(train_step, objective))(state, batch, jax.random.key(0))

    theirs = step.step(step.tensors(batch))
    # The paper does not have the term of angles (D21).
    losses = [name for name in metrics if name.startswith("loss/") and name != "loss/angle"]
    ours = {name.removeprefix("loss/"): float(metrics[name]) for name in losses}
    assert theirs.keys() == ours.keys()
    for name, value in ours.items():
        assert float(theirs[name]) == pytest.approx(value, rel=1e-3, abs=1e-5), name
    assert _norm(step.generator) == pytest.approx(float(metrics["grad_norm/generator"]), rel=1e-3)
    assert _norm(step.discriminator) == pytest.approx(float(metrics["grad_norm/discriminator"]), rel=1e-3)
    ours_after = after.generator.params["pose_2"]["linear"]["bias"]
    np.testing.assert_allclose(step.generator.pose_2.linear.bias.detach(), ours_after, atol=1e-5)


def test_three_passes_give_the_same_terms_and_change_both_networks(torch, torch_peer, config, make_batch):
    objective = _objective(config)
    step = torch_peer.TorchStep(config, objective, passes=3)
    before = [parameter.clone() for parameter in (step.generator.pose_1.linear.bias, step.discriminator.conv_1.bias)]
    terms = step.step(step.tensors(make_batch(objective, 2)))
    assert terms.keys() == {*objective.weights._asdict(), "total", "discriminator"} - {"angle"}
    assert all(bool(torch.isfinite(term)) for term in terms.values())
    after = [step.generator.pose_1.linear.bias, step.discriminator.conv_1.bias]
    assert not any(torch.equal(a, b) for a, b in zip(before, after, strict=True))


def test_a_process_runs_its_steps_and_says_when_it_has_ended(torch_peer, config):
    config.train.batch_size = 2
    process = torch_peer.TorchProcess(config, [torch_peer.Choice(1, False), torch_peer.Choice(3, False)], 1)
    try:
        assert process.run(0) > 0 and process.run(1) > 0
        with pytest.raises(UserError, match=r"the process of PyTorch ended \(exit code 1\)"):
            process.run(2)  # there are two steps
    finally:
        process.close()
