"""The factorial study: known effects, verdicts that follow the protocol, and a report that no interruption changes."""

import json
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import power
import pytest
import reproduce
from tables import factorial, hands
from tables.claims import HELD, NOT_HELD, UNDECIDED, Measured
from tables.factorial import QUESTIONS, SPLITS, effect, gate, judge, more_blocks
from tables.kept_runs import FILE
from tables.plan import Request, plan_table

from ha2g_jax.config import presets
from ha2g_jax.skeleton import load_skeleton

from ..factorial_study import SPEAKERS, perform, scores

COMMAND = pathlib.Path(__file__).parents[1] / "factorial_study.py"


@pytest.fixture
def talk(corpus):
    """A corpus without clips that has the splits of the study."""
    metadata = json.loads((corpus / "dataset.json").read_text())
    metadata["splits"]["test_unseen_speakers"] = metadata["splits"].pop("test")
    (corpus / "dataset.json").write_text(json.dumps(metadata))
    return corpus


@pytest.fixture
def study(talk, tmp_path):
    request = Request("factorial", "talk", "debug", str(talk), (0, 1, 2), tmp_path / "runs")
    plan = plan_table(request)
    return plan, {
        name: {run.seed: scores(run) for run in runs if run.seed in request.seeds} for name, runs in plan.rows.items()
    }


def _blocks(*values, spread=0.0):
    return [Measured(value, value + spread * np.array([-1.0, 0.0, 1.0])) for value in values]


def test_cells_are_all_combinations_and_the_gate_comes_first(study):
    plan, _ = study
    first, second, *others = plan.runs
    assert first.config.model.text.kind == "oracle" and "oracle" not in "".join(run.name for run in plan.runs[1:])
    assert list(plan.rows)[:2] == list(factorial.GATE_ROWS) and second == plan.rows[presets.FULL][0]
    seen = {
        (tuple(run.config.model.inferer.levels), run.config.loss.ha2g.text, run.config.model.inferer.coordinator)
        for run in others
    }
    assert len(plan.runs) == 1 + 8 * factorial.SEEDS and len(seen) == 8


def test_an_effect_is_the_mean_of_four_cells_less_that_of_the_others(study):
    _, found = study
    del found[presets.ORACLE]
    style = QUESTIONS[2]
    blocks = effect(found, style.control, style.measures[0])
    by_hand = []
    for seed in range(3):
        values = {
            row: np.mean([_value(mine, seed, name) for name in style.measures[0].metrics])
            for row, mine in found.items()
        }
        off = [value for row, value in values.items() if style.control in row]
        on = [value for row, value in values.items() if style.control not in row]
        by_hand.append(np.mean(on) - np.mean(off))
    assert [block.value for block in blocks.values()] == pytest.approx(by_hand)
    assert len(blocks[0].without) == len(SPEAKERS)
    del found[presets.FULL][1]
    assert [*effect(found, style.control, style.measures[0])] == [0, 2]
    hierarchy = effect(found, QUESTIONS[1].control, QUESTIONS[1].measures[0])
    assert [block.value for block in hierarchy.values()] == pytest.approx([np.log(2 / 3)] * 2, abs=0.02)


def test_the_spread_of_a_run_is_what_its_cell_and_its_block_do_not_explain(study):
    _, found = study
    cells = [found[row] for row in found if row != presets.ORACLE]
    for number, cell in enumerate(cells):
        for seed in range(3):
            one = cell[seed]["splits"][SPLITS[1]]["talk"]["rows"]["model"]["finger_correlation"]
            one["value"] = number + seed / 10 + (0.24 if number == seed == 0 else 0)
    assert power.read_spreads(found)[0][0].run == pytest.approx(0.24 * (7 / 8 * 2 / 3 / 14) ** 0.5)


def _value(mine, seed, metric):
    return mine[seed]["splits"][SPLITS[1]]["talk"]["rows"]["model"][metric.removeprefix("talk.")]["value"]


@pytest.mark.parametrize(
    ("fingers", "probe", "verdict"),
    [
        (_blocks(0.3, 0.31, 0.32), _blocks(0.1, 0.11, 0.12), HELD),
        (_blocks(0.3, 0.31, 0.32), _blocks(-0.001, 0.0, 0.001), NOT_HELD),  # an advantage of .05 is excluded
        (_blocks(0.3, 0.31, 0.32), _blocks(-0.2, 0.0, 0.3), UNDECIDED),
        (_blocks(-0.3, -0.31, -0.32), _blocks(0.1, 0.11, 0.12), NOT_HELD),
        (_blocks(0.3, 0.31, 0.32, spread=0.5), _blocks(0.1, 0.11, 0.12), UNDECIDED),  # other speakers
        (_blocks(0.3), _blocks(0.1), UNDECIDED),
        ([], [], UNDECIDED),
    ],
)
def test_verdicts_follow_the_protocol(fingers, probe, verdict):
    answers = judge([[fingers, probe], [_blocks(0.1, -0.1, 0.0)], [_blocks(0.1, -0.3, 0.2)]])
    assert [answers[0].verdict, answers[2].verdict] == [verdict, UNDECIDED]


def test_a_lower_distance_is_an_advantage_and_more_blocks_are_foreseen():
    (answer,) = judge([[_blocks(-0.3, -0.31, -0.29)]], QUESTIONS[1:2])
    assert answer.verdict == HELD
    assert more_blocks(QUESTIONS[1], [_blocks(-4.0, 4.0, -0.1)]) is None


def test_the_number_of_further_blocks_is_the_one_at_which_half_an_interval_and_the_power_fit():
    """By hand: standard deviation .2 over blocks, effect 0, .0953 matters, 5 % for three claims: n = 49 is the first
    with .0953 >= (t(.9917, n - 1) + t(.8, n - 1)) .2 / sqrt(n).
    """
    hierarchy, contrastive = QUESTIONS[1], QUESTIONS[0]
    assert more_blocks(hierarchy, [_blocks(-0.2, 0.0, 0.2)]) == 49 - 3
    assert more_blocks(hierarchy, [_blocks(-0.2, 0.0, 0.2, spread=0.05)]) is None  # however many, speakers may differ
    assert more_blocks(hierarchy, [_blocks(0.2)]) == 1
    # Of two measures one is enough that excludes what matters of it.
    assert more_blocks(contrastive, [_blocks(0.4, 0.0, 0.2), _blocks(0.0, 0.03, -0.03)]) == 4


def test_a_claim_whose_errors_are_not_known_counts_for_the_correction():
    known = _blocks(0.1, 0.12, 0.19)
    alone, together = (judge([[known]] * count, QUESTIONS[2:] * count)[0] for count in (1, 3))
    unknown = judge([[known], [_blocks(0.1)], [[]]], QUESTIONS[2:] * 3)[0]
    assert unknown.p_value == together.p_value == pytest.approx(3 * (alone.p_value or 0))


def test_a_failed_gate_leaves_the_claims_undecided(study):
    plan, found = study
    assert gate(found, "small")[1] and not gate({presets.FULL: found[presets.FULL]}, "small")[1]
    (run,) = plan.rows[presets.ORACLE]
    found[presets.ORACLE] = {0: scores(run, oracle=0.4)}
    assert not gate(found, "small")[1] and gate(found, "debug")[1]
    page = factorial.as_markdown("small", {presets.FULL: {}}, found, {}, "")
    assert "**not passed**" in page and page.count("**undecided**") == 3
    assert "**not passed**" in factorial.as_markdown(
        "small", {presets.FULL: {}}, {presets.ORACLE: found[presets.ORACLE]}, {}, ""
    )
    del found[presets.ORACLE]
    assert "**open**" in factorial.as_markdown("small", {presets.FULL: {}}, found, {}, "")


def test_the_distance_of_hands_sees_fingers_alone():
    skeleton, rng = load_skeleton("ted_expressive"), np.random.default_rng(0)
    motions = [
        skeleton.mean_directions + 0.3 * np.cumsum(rng.normal(size=(180, 42, 3)), axis=0) / 10 for _ in range(12)
    ]
    speakers = ["ada", "bea", "cyd"] * 4
    axes = hands.principal_axes(skeleton, motions)
    assert axes.shape == (340, hands.COMPONENTS)
    value, without = hands.hands_fgd(skeleton, axes, motions, motions, speakers)
    assert value == 0 and without == dict.fromkeys(("ada", "bea", "cyd"), 0)
    arms, fingers = [motion.copy() for motion in motions], [motion.copy() for motion in motions]
    for arm, finger in zip(arms, fingers, strict=True):
        arm[:, skeleton.bone("left_elbow")] = (0.0, 1.0, 0.0)
        finger[:, skeleton.bone("left_index_2")] = finger[:, skeleton.bone("left_index_1")]
    assert hands.hands_fgd(skeleton, axes, arms, motions, speakers)[0] == 0
    value, without = hands.hands_fgd(skeleton, axes, fingers, motions, speakers)
    kept = [index for index, name in enumerate(speakers) if name != "ada"]
    alone, _ = hands.hands_fgd(
        skeleton, axes, [fingers[i] for i in kept], [motions[i] for i in kept], [speakers[i] for i in kept]
    )
    assert value > 0 and without["ada"] == pytest.approx(alone)


def _arguments(talk, folder):
    return [
        *("factorial", "--continue", "--size", "debug", "--seeds", "3", "--data", f"talk:{talk}"),
        *("--workdir", str(folder / "runs"), "--keep", str(folder / "kept"), "--out", str(folder / "factorial.md")),
    ]


def test_a_study_that_is_killed_twice_goes_on_to_the_same_report(talk, tmp_path):
    whole, killed, clone = (tmp_path / name for name in ("whole", "killed", "clone"))
    assert reproduce.main(_arguments(talk, whole), perform) == 0
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    for number, runs in ((signal.SIGTERM, 5), (signal.SIGKILL, 14)):
        process = subprocess.Popen([sys.executable, str(COMMAND), *_arguments(talk, killed)], env=environment)
        kept, end = killed / "kept" / FILE, time.monotonic() + 60
        while process.poll() is None and not (kept.exists() and len(kept.read_text().splitlines()) > runs):
            assert time.monotonic() < end
            time.sleep(0.005)
        process.send_signal(number)
        assert process.wait() == {signal.SIGTERM: 128 + signal.SIGTERM, signal.SIGKILL: -signal.SIGKILL}[number]
        shutil.rmtree(killed / "runs")  # it goes on elsewhere, from what is kept
    trained = []

    def perform_and_note(request, run, worker, stop):
        trained.append(run.name)
        perform(request, run, worker, stop)

    assert reproduce.main(_arguments(talk, killed), perform_and_note) == 0
    assert 0 < len(trained) <= 1 + 25 - 14 and not any("autoencoder" in name for name in trained)
    shutil.copytree(killed / "kept", clone / "kept")
    assert reproduce.main([*_arguments(tmp_path / "nowhere", clone), "--no-train"], perform) == 0
    pages = [(folder / "factorial.md").read_bytes() for folder in (whole, killed, clone)]
    assert pages[0] == pages[1] == pages[2]

    last = next(killed.glob("runs/*/*-ha2g-*-seed2"))
    begun = last.with_name(last.name.replace("-seed2", "-seed3")) / "latest" / "10"
    begun.mkdir(parents=True)
    (begun / "SHA256SUMS").write_text("a part")
    numbers = (killed / "factorial.csv").read_bytes()
    assert reproduce.main([*_arguments(talk, killed), "--no-train"], perform) == 0
    assert (killed / "factorial.md").read_bytes() == pages[0] and (killed / "factorial.csv").read_bytes() == numbers

    text = pages[0].decode()
    assert "Blocks: 3 of 8 (seeds 0, 1, 2); runs that are missing: 40." in text
    assert text.count("| **held** | 3 | 0 |") == 2 and "| **not held** | 3 | 0 |" in text
    assert "0.001 hours" in (killed / "factorial.csv").read_text()
