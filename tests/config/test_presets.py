"""Every preset can be built and trained; rows of the paper's tables differ from the full model where it says."""

import functools

import jax
import jax.numpy as jnp
import pytest

from ha2g_jax import methods
from ha2g_jax.config import presets, settings
from ha2g_jax.errors import UserError
from ha2g_jax.methods.method import example_batch
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.train.objective import build_objective, init_state
from ha2g_jax.train.step import train_step

# HA2G on each kind of data, and each method on one.
SPECS = [*((data, "ha2g") for data in presets.DATA), *(("talk", name) for name in presets.METHODS if name != "ha2g")]
BASELINES = ("seq2seq", "speech2gesture", "joint_embedding", "trimodal")
EQUAL = [("talk", name, presets.equal(name, "debug")) for name in ("seq2seq", "joint_embedding")]
# Those of bvh and of video have the networks of ted_expressive and of talk, and ha2g_release has the step of ha2g.
_ALIKE = ("bvh", "video", "ha2g_release")
STEPS = [*((*spec, {}) for spec in SPECS if not {*spec} & {*_ALIKE}), *EQUAL]


def build(config):
    return methods.build(config, load_skeleton(config.skeleton), vocabulary_size=10, num_speakers=3)


@pytest.mark.parametrize("size", presets.SIZES)
@pytest.mark.parametrize(("data", "method"), SPECS)
def test_every_preset_builds_an_objective(data, method, size):
    config = presets.make(data, size, method)
    settings.check(config)
    spec = build_objective(config, load_skeleton(config.skeleton), vocabulary_size=10, num_speakers=3).spec
    if config.method == "ha2g":
        assert len(spec.generator.level_channels) == {"ted_expressive": 6, "ted_gesture": 3}[config.skeleton]
    assert (config.name, spec.method) == (method, config.method) and spec.num_frames == 34


@pytest.mark.parametrize(("data", "method", "changes"), STEPS)
def test_every_debug_preset_gives_a_step_in_float32(data, method, changes):
    """It is so where JAX is told to use float64, too."""
    config = presets.make(data, "debug", method, changes)
    if method == "ha2g" and data != "ted_expressive":  # which has all six
        config.model.inferer.levels = (3,) if data == "ted_gesture" else (6,)
    objective = build_objective(config, load_skeleton(config.skeleton), vocabulary_size=10, num_speakers=3)
    with jax.enable_x64():
        key = jax.random.key(0)
        batch = {name: jnp.repeat(array, 2, axis=0) for name, array in example_batch(objective.spec).items()}
        state = jax.eval_shape(functools.partial(init_state, objective), key)
        after, metrics = jax.eval_shape(functools.partial(train_step, objective), state, batch, key)
    assert not [leaf for leaf in jax.tree.leaves((state, after, metrics)) if leaf.dtype == jnp.float64]
    assert jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), after) == jax.tree.map(
        lambda leaf: (leaf.shape, leaf.dtype), state
    )
    assert {f"loss/{name}" for name in config.loss[config.method].weights} < metrics.keys()


@pytest.mark.parametrize("table", presets.TABLES)
def test_every_row_of_a_table_builds_and_is_another_config(table):
    data = "ted_gesture" if table == "gesture_ablation" else "talk"
    configs = [presets.make(data, "debug", changes=changes) for changes in presets.TABLES[table].values()]
    assert all(build(config) for config in configs)
    assert len({config.to_json() for config in configs}) == len(configs)


def test_stages_that_an_ablation_leaves_out_are_gone():
    widths = {
        name: [
            len(channels) for channels in build(presets.make("talk", "debug", changes=changes)).generator.level_channels
        ]
        for name, changes in presets.TABLES["table4"].items()
    }
    assert widths["Holistic"] == [126]
    assert widths["without hand hierarchy"] == [24, 30, 36, 126]
    assert widths["without body hierarchy"] == [36, 66, 96, 126]
    assert widths["HA2G Full"] == [24, 30, 36, 66, 96, 126]


def test_an_unknown_name_is_named():
    with pytest.raises(UserError, match="no method 'gpt'; expected one of ha2g"):
        presets.make("talk", method="gpt")


@pytest.mark.parametrize("levels", [(1, 2), (2, 1, 6), (0, 6), (6, 6)])
def test_levels_that_do_not_end_in_the_whole_pose_are_refused(levels):
    config = presets.make("talk", "debug", changes={"model.inferer.levels": levels})
    with pytest.raises(UserError, match=r"config.model.inferer.levels"):
        build(config)


@pytest.mark.parametrize("size", ["small", "medium"])
def test_cells_of_the_factorial_study_have_as_many_parameters(size):
    """Within 1 %, of what makes poses from features and of all networks."""
    counts = {}
    for name, changes in presets.factorial(size).items():
        if presets.OTHER_TEXT not in name:  # which changes a term alone
            config = presets.make("talk", size, changes=changes)
            params = methods.variable_shapes(build(config))["params"]
            parts = {part: sum(leaf.size for leaf in jax.tree.leaves(tree)) for part, tree in params.items()}
            makes_poses = sum(count for part, count in parts.items() if part.startswith(("pose_", "coordinator")))
            counts[name] = (makes_poses, sum(parts.values()))
    assert len(counts) == 5
    for found in counts.values():
        assert found == pytest.approx(counts[presets.FULL], rel=0.01)


@pytest.mark.parametrize("size", ["study", "small", "medium"])
def test_baselines_of_equal_size_have_as_many_parameters_that_generate(size):
    only_trains, counts = {"ha2g": "text", "joint_embedding": "pose_encoder"}, {}
    for method in ("ha2g", *BASELINES):
        config = presets.make("talk", size, method, {} if method == "ha2g" else presets.equal(method, size))
        params = methods.variable_shapes(build(config))["params"]
        parts = {part: tree for part, tree in params.items() if part != only_trains.get(method)}
        counts[method] = sum(leaf.size for leaf in jax.tree.leaves(parts))
    assert all(count == pytest.approx(counts["ha2g"], rel=0.01) for count in counts.values())
