"""Measure how strongly each term of the objective pulls on a model: the norm of its gradient times its weight.

The terms of Eq. 9 have units of their own, so that neither their values nor their weights say which of them decides
what is learned. The norms of their gradients do.
"""

import contextlib
import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint.state import TrainState
from ha2g_jax.config.settings import Config
from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.data.talk.build import talk_path
from ha2g_jax.errors import UserError
from ha2g_jax.methods import method_of
from ha2g_jax.methods.ha2g.losses import is_rigid
from ha2g_jax.methods.method import Batch, subtract_mean
from ha2g_jax.progress import stage
from ha2g_jax.stopping import leaving_on_signals
from ha2g_jax.train import inputs
from ha2g_jax.train.objective import Objective, build_objective, init_state
from ha2g_jax.train.step import loss_terms, run_generator, step_keys


class TermGradients(NamedTuple):
    """Gradients of the terms for one state of a model, each an array (terms + 1,).

    The terms are in the order of `Objective.weights`; the last value is that of the objective, their weighted sum.

    Attributes:
        value: the terms, unweighted, and the objective.
        parameters: weight times the norm of the gradient with respect to all parameters of the generator.
        output: weight times the norm of the gradient with respect to the poses (B, N, pose_dim) of the last level.
    """

    value: jax.Array
    parameters: jax.Array
    output: jax.Array


@functools.partial(jax.jit, static_argnums=0)
def term_gradients(objective: Objective, state: TrainState, batch: Batch, key: jax.Array) -> TermGradients:
    """Compute the gradient of each term in training mode, with the GAN term also during warm-up.

    The arguments are those of `ha2g_jax.train.step.train_step`.
    """
    keys = step_keys(objective.spec, key, state.step)
    targets = subtract_mean(objective.spec, batch["directions"])
    run, pull_back = run_generator(objective, state.generator, batch, keys)

    def terms(outputs: Any) -> jax.Array:
        changed = run._replace(outputs=outputs)
        return jnp.stack(loss_terms(objective, state.discriminator, changed, targets, keys["gan"], train=True))

    def norms(weights: jax.Array) -> tuple[jax.Array, jax.Array]:
        (cotangent,) = pull_terms(weights)
        (gradient,) = pull_back(cotangent)
        return optax.tree.norm(gradient), optax.tree.norm(cotangent.poses[-1])

    values, pull_terms = jax.vjp(terms, run.outputs)
    weights = jnp.array(objective.weights)
    # One term after the other, so that memory and compilation are those of one gradient.
    found = jax.lax.map(norms, jnp.concatenate([jnp.diag(weights), weights[None]]))
    return TermGradients(jnp.append(values, weights @ values), *found)


def measure(config: Config, sources: Sequence[str] = ()) -> dict[str, Any]:
    """Measure the gradients of a config on the first training batch of its data.

    The sources are runs or model folders whose generators are measured beside that of a new run, with their own
    networks and the objective and the data of the config. The discriminator is a new one in any case.

    Returns:
        Plain values: "config", "batch_size", "reconstruction" (name of a term), "rigid_pairs" and "pairs" (numbers of
        angles), "terms" with a list of {"name", "weight"}, and "models" with {"name", "value", "parameters", "output"}
        for "new" and each source. The last term is "total".

    Raises:
        UserError: the data or a source cannot be used, a source is of another method or for other words or speakers, or
            the gradients fail, for example for lack of memory.
    """
    talk_path(config.data.path)
    corpus = inputs.open_corpus(config)
    trained = {source: model_folder.load(source) for source in sources}
    for source, model in trained.items():
        if model.config.method != config.method:
            raise UserError(f"{source} is a model of {model.config.method}, but the config of {config.method}")
    models = [{"name": "new"} | _measure(config, corpus, None)]
    for source, model in trained.items():
        own = config.copy_and_resolve_references()
        with own.unlocked():
            own.model = model.config.model
        models.append({"name": source} | _measure(own, corpus, (source, model.variables)))
    objective = _build(config, corpus)
    weights = objective.weights._asdict() | {"total": 1.0}
    return {
        "config": config.name,
        "batch_size": config.train.batch_size,
        "reconstruction": method_of(objective.spec).reconstruction_term,
        "rigid_pairs": int(is_rigid(corpus.skeleton.angle_variance).sum()),
        "pairs": len(corpus.skeleton.angle_pairs),
        "terms": [{"name": name, "weight": weight} for name, weight in weights.items()],
        "models": models,
    }


def _build(config: Config, corpus: Corpus) -> Objective:
    return build_objective(config, corpus.skeleton, len(corpus.vocabulary()), len(corpus.speakers_of(TRAIN)))


def _measure(config: Config, corpus: Corpus, trained: tuple[str, dict[str, Any]] | None) -> dict[str, Any]:
    """Return the fields of `TermGradients` for a new generator, or for that of (name, variables)."""
    objective, vocabulary = _build(config, corpus), corpus.vocabulary()
    windows = inputs.open_windows(config, objective.spec, corpus, TRAIN)
    with contextlib.closing(inputs.training_batches(config, windows, 0)) as batches:
        batch = next(batches)
    init_key, key = jax.random.split(jax.random.key(config.seed))  # as a run does
    with stage("initialising the networks"):
        pretrained = {} if trained else inputs.pretrained(config, objective.spec, vocabulary)
        state = init_state(objective, init_key, pretrained)
    if trained is not None:
        source, variables = trained
        found, expected = (jax.tree.map(jnp.shape, tree) for tree in (variables, state.generator.variables))
        if found != expected:
            raise UserError(
                f"{source} has networks of other sizes: it was trained for other words or speakers than those of "
                f"{corpus.path}, or with another data.mirror"
            )
        state = state.replace(generator=state.generator.replace(**jax.tree.map(jnp.asarray, variables)))
    try:
        with stage("compiling the gradients of the terms, which takes minutes on a CPU"), leaving_on_signals():
            found = term_gradients(objective, state, batch, key)._asdict()
            return {field: values.tolist() for field, values in found.items()}
    except jax.errors.JaxRuntimeError as error:
        why = str(error).splitlines()[0]
        raise UserError(f"the gradients fail ({why}): take a smaller size, or a config with a smaller batch") from error


def as_table(result: dict[str, Any]) -> str:
    """Format the result of `measure` as a table in Markdown, one row for each term."""
    reference = result["reconstruction"]
    names = [term["name"] for term in result["terms"]]
    columns = ["term", "weight"]
    for model in result["models"]:
        columns += [f"{model['name']}: value", "gradient", f"of {reference}'s", "at the output"]
    rows = [columns, ["---", *["--:"] * (len(columns) - 1)]]
    for place, term in enumerate(result["terms"]):
        row = [term["name"], f"{term['weight']:g}"]
        for model in result["models"]:
            norm, whole = model["parameters"][place], model["parameters"][names.index(reference)]
            ratio = f"{norm / whole:.3g}" if whole else "-"
            row += [f"{model['value'][place]:.3g}", f"{norm:.3g}", ratio, f"{model['output'][place]:.3g}"]
        rows.append(row)
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    note = f"\n\n{result['rigid_pairs']} of {result['pairs']} angles are rigid; the physical term leaves them out."
    return table + (note if "physical" in names else "")
