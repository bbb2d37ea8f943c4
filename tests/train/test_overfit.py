"""The networks can overfit one batch, with every term that does not pull away from the true poses."""

import functools

import jax
import numpy as np

from ha2g_jax.config import presets
from ha2g_jax.data.corpus import TRAIN
from ha2g_jax.train import inputs
from ha2g_jax.train.objective import build_objective
from ha2g_jax.train.step import train_step


def test_one_batch_is_learnt_by_heart_in_100_steps(tiny_talk, draw_state):
    config = presets.sized("ted_expressive", "debug")
    config.model.identity.kind = "speakers"
    config.model.inferer.levels = (6,)
    config.data.path = str(tiny_talk)
    config.train.batch_size = 2
    config.train.update({"steps": 100, "learning_rate": 1e-2, "schedule": "cosine"})
    # The physical term holds joints at their mean angles, and the Huber term at 2 %. The style term holds the poses
    # away from those with the other identity, and the Huber term at 5 %.
    config.loss.ha2g.weights.update({"physical": 0.0, "style": 0.0})
    corpus = inputs.open_corpus(config)
    vocabulary, speakers = corpus.vocabulary(), corpus.speakers_of(TRAIN)
    objective = build_objective(config, corpus.skeleton, len(vocabulary), len(speakers))
    windows = inputs.open_windows(config, objective.spec, corpus, vocabulary, TRAIN)
    examples = [windows[index] for index in range(config.train.batch_size)]
    batch = {name: np.stack([example[name] for example in examples]) for name in examples[0]}

    assert objective.warmup_steps == 0
    step = jax.jit(functools.partial(train_step, objective), donate_argnums=0)
    state, history = draw_state(objective), []
    for _ in range(config.train.steps):
        state, metrics = step(state, batch, jax.random.key(1))
        history.append(metrics["loss/huber"])
    assert history[-1] < 0.01 * history[0]
