"""The study of look-aheads: leave-one-out scores, intervals and verdicts with known answers, the page and its chart."""

import json
import pathlib

import latency as command
import pytest
from tables import look_aheads
from tables.claims import HELD, NOT_HELD, UNDECIDED, Spread
from tables.latency_report import Results, answers
from tables.look_aheads import ABOVE_FLOOR, GAIN, HIDDEN, LOOK_AHEADS, WHOLE, plan_settings, scores_path
from tables.plan import Request
from tables.runs import Stop

from ha2g_jax.errors import UserError

NAMES = ("beat_f1", GAIN, "semantic_recall", ABOVE_FLOOR, "jerk_ratio", "beats_per_second")


def scores(value: float, spread: float = 0.0) -> dict:
    """Scores of one run on three recordings, all with the same value, which differs by `spread` without a recording."""
    one = {"value": value, "without": [value - spread, value, value + spread]}
    return {
        "recordings": ["a", "b", "c"],
        "model_scores": dict.fromkeys(NAMES, one),
        "truth_scores": dict.fromkeys(NAMES, one | {"value": 0.8}),
    }


def curve(values: dict[int | None, float], seeds: int = 3) -> dict:
    """Scores at each look-ahead; seeds differ by 0.001."""
    return {at: {seed: scores(value + 0.001 * seed) for seed in range(seeds)} for at, value in values.items()}


@pytest.fixture
def results():
    rising = {0: 0.0, 1: 0.0, 2: 0.01, 3: 0.1, 5: 0.2, 8: 0.26, 15: 0.28, None: 0.3}
    flat = dict.fromkeys(LOOK_AHEADS, 0.04) | {None: 0.31}
    request = Request("latency", "talk", "study", "", (0, 1, 2), pathlib.Path("runs"))
    return Results(request, 15, {HIDDEN: curve(rising), WHOLE: curve(flat)}, {}, {}, {"commit": "abc"})


def test_differences_are_paired():
    first = {seed: scores(value + 0.1, 0.05) for seed, value in enumerate((0.1, 0.5, 0.9))}
    second = {seed: scores(value, 0.05) for seed, value in enumerate((0.1, 0.5, 0.9, 0.3))}
    found = look_aheads.difference(first, second, GAIN)
    assert found and (found.num, found.mean) == (3, pytest.approx(0.1)) and found.low == pytest.approx(0.1)
    assert look_aheads.difference(first, {}, GAIN) is None


def test_verdicts_follow_the_rules():
    better, none, worse = Spread(0.1, 0.01, 0.2, 3), Spread(0.0, -0.04, 0.04, 3), Spread(-0.1, -0.2, -0.06, 3)
    assert [look_aheads.is_better(found) for found in (better, none, worse, None)] == [
        HELD,
        UNDECIDED,
        NOT_HELD,
        UNDECIDED,
    ]
    assert [look_aheads.is_no_worse(found, 0.05) for found in (better, none, worse)] == [HELD, HELD, NOT_HELD]
    assert look_aheads.is_no_worse(Spread(0.0, -0.07, 0.07, 3), 0.05) == UNDECIDED
    assert look_aheads.all_of([HELD, HELD]) == HELD and look_aheads.all_of([HELD, UNDECIDED]) == UNDECIDED
    assert look_aheads.all_of([HELD, UNDECIDED, NOT_HELD]) == NOT_HELD
    assert look_aheads.smallest_within({3: worse, 5: Spread(0.04, 0.0, 0.08, 3), 8: none}, 0.05) == (3, 3)
    assert look_aheads.smallest_within({3: better, 5: Spread(0.04, 0.0, 0.08, 3), 8: none}, 0.05) == (5, 8)
    assert look_aheads.smallest_within({3: better, 5: None}, 0.05) == (None, None)


def test_answers_follow_from_the_scores(results):
    found = "\n".join(answers(results))
    assert "(a) hidden ends better in beat F1 gain at 3 frames: **held**. hidden ends 0.101 [" in found
    assert found.count("at 3 frames: **held**") == 2 and "difference 0.060 [0.060, 0.060]" in found
    assert "(c) hidden ends no worse with the whole file: **held**" in found
    assert "hidden ends: **8 frames (533 ms)**" in found and "whole windows: **none of them**" in found
    assert "beat F1 gain is above 0 from this look-ahead on: hidden ends 2 frames (133 ms)" in found


@pytest.fixture
def request_(tmp_path, corpus):
    return Request("latency", "talk", "debug", str(corpus), (0, 1), tmp_path / "runs")


def _perform(request, run, worker, stop):
    """Stands for training and scoring."""
    plan = plan_settings(request)
    steps = str(run.config.train.steps)
    for name in ("best", "latest"):
        (run.workdir / name / steps).mkdir(parents=True, exist_ok=True)
        (run.workdir / name / steps / "SHA256SUMS").write_text(run.name)
    (run.workdir / "config.json").write_text(run.config.to_json())
    for at in LOOK_AHEADS:
        path = scores_path(run, plan, "test", at)
        assert path
        path.write_text(json.dumps(scores(0.2)))


def test_missing_runs_are_made_once_and_reported(request_, tmp_path):
    out, performed = tmp_path / "page.md", []

    def perform(request, run, worker, stop):
        if "seed1" in run.name and "hidden-ends" in run.name and len(performed) < 4:
            performed.append(run.name)
            raise UserError("no memory")
        performed.append(run.name)
        _perform(request, run, worker, stop)

    assert not command.study_latency(request_, out, "the command", Stop(), perform)
    assert len(performed) == 4 and "- hidden ends, seed 1: no memory" in out.read_text()
    assert command.study_latency(request_, out, "the command", Stop(), perform)
    assert len(performed) == 5 and "no memory" not in out.read_text() and out.with_suffix(".svg").exists()
    assert command.study_latency(request_._replace(has_training=False), out, "the command", Stop(), perform)
    assert len(performed) == 5
