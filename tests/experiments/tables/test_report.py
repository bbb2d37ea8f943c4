"""The page has the paper's numbers beside ours, verdicts and caveats that follow from what was run."""

import csv
import pathlib
from typing import Any

import pytest
from tables import paper_tables, tables
from tables.kept_runs import Kept
from tables.plan import Request, TablePlan
from tables.report import Results, all_numbers, as_markdown
from tables.workdirs import Record, Run

from ha2g_jax.config import presets
from ha2g_jax.data.corpus import Corpus


def _three(value, spread=0.1):
    return {"value": value, "low": value - spread, "high": value + spread}


def _score(value: float | None, error: float | None = 0.01) -> dict[str, Any]:
    bounds = (None, None) if value is None or error is None else (value - 1.96 * error, value + 1.96 * error)
    return {"value": value, "low": bounds[0], "high": bounds[1], "error": error}


def _scores(fgd, recall, gain=0.2) -> dict[str, Any]:
    rows = {"model": {"fgd": _three(fgd), "beat_gain": _three(gain), "diversity_l1": _three(30.0) | {"sd": 0.1}}}
    rows |= {"ground truth": {"fgd": _three(0.0)}, "white jitter": {"fgd": _three(99.0)}}
    known: dict[str, Any] = {
        name: {"semantic_recall": _score(value)} for name, value in (("majority", 0.1), ("shuffled", 0.12))
    }
    known["model"] = {"beat_f1": _score(0.5), "semantic_recall": _score(recall), "style_amplitude": _score(None, None)}
    known["model"] |= {"finger_correlation": _score(0.4)}
    known["model"] |= {"beat_f1_gain": _score(0.3), "beat_f1_strict_gain": _score(0.2)}
    known["teacher"] = {"beat_f1": _score(0.9), "semantic_recall": _score(0.8)}
    split = {
        "evaluation": {
            "rows": rows,
            "flags": [
                "diversity L1: white jitter (44.00) higher than ground truth (30.00)",
                "model: 9.00 beats/s, far",
                "R: white jitter",
            ],
            "warnings": ["200 windows for 128 latent values"],
            "legacy_v1": {"rows": {"model": {"legacy_fgd": {"value": 7.5, "low": None, "high": None}}}},
        },
        "talk": {"rows": known},
        "draws": {"model": [30.0, 30.3], "ground truth": [40.0, 40.2]},
        "sweep": {
            name: {"consistency": [0.6] * 30, "own": [0.5] * 29 + [None], "mismatched": [0.4] * 30}
            for name in ("model", "ground truth")
        },
    }
    return {"autoencoder": "cafe", "splits": {"test": split}}


def _results(name="table1", data="talk", size="small", seeds=3, steps=None, **changes):
    """The results of a table whose runs have all trained to the end; `changes` are of the request, the plan or them."""
    table = paper_tables.table(name, data)
    records = {
        row.name: {
            seed: Record(
                f"run-{row.method}-{seed}",
                seed,
                {"train": {"steps": (steps or {}).get(row.name, 100), "batch_size": 4, "best_by": "loss/huber"}},
                [],
                (steps or {}).get(row.name, 100),
                50,
                [{"step": 50, "validation/loss/huber": 0.25}],
                _scores(2.0 + 0.01 * seed if row.name == table.reference else 3.0 + 0.02 * seed, 0.3),
            )
            for seed in range(seeds)
        }
        for row in table.rows
    }
    request = Request(name, data, size, "", tuple(range(seeds)), pathlib.Path("runs"))
    autoencoder = Run("run-autoencoder", 0, presets.make(data, "debug", "autoencoder"), pathlib.Path("runs"))
    plan = TablePlan(Corpus(pathlib.Path(), {}), "", Kept(), {}, table, autoencoder, ("test",), {}, 1000)
    values = Results(request, plan, records, {}, {"command": "`reproduce`", "commit": "abc"})
    return values._replace(**changes)


def _page(*arguments, **changes):
    return as_markdown(_results(*arguments, **changes), "page.csv")


def _cells(report, row, heading="## Scores on test"):
    """The cells of a line of the first table after a heading."""
    lines = report[report.index(heading) :].splitlines()
    return next(
        [cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith(f"| {row} |")
    )


def test_the_paper_s_numbers_stand_beside_ours():
    cells = _cells(_page(), "Trimodal")
    # 3.02 with half a t interval of 4.3027 x 0.02 / sqrt(3).
    assert cells[1:3] == ["12.61, 0.592, 154.1", "3.020 ±0.050"] and cells[-1] == "3"
    assert cells[4] == "0.200 ±0.000"
    assert _cells(_page(), "Ground Truth")[1:3] == ["0.000, 0.723, 175.2", "0.000"]
    assert _cells(_page(), r"*white jitter*")[1:3] == ["", "99.00"]


def test_claims_have_verdicts():
    cells = _cells(_page(), "Trimodal", "## Claims")
    assert cells[1] == "**held** -1.010 [-1.136, -0.884], p<0.001"
    assert cells[2] == "**undecided** 0.000 [0.000, 0.000], p=1.000" == cells[4]
    assert "| HA2G |" not in _page()[: _page().index("## Scores")]
    assert "- test: FGD 6 held; beat gain 6 undecided; " in _page()
    about_as_good = _cells(_page("table3"), "HA2G-ASR", "## Claims")
    assert about_as_good[1].startswith("**not held**")


def test_known_causes_are_only_talk_s():
    cells = _cells(_page(), "HA2G")
    assert [cell[:5] for cell in cells[8:11]] == ["0.300", "0.400", "0.180"] and cells[11] == "-"
    assert _cells(_page(), "*teacher*")[10] == "0.680"
    assert "Hand shapes of words: above the floors: Attention Seq2Seq, Speech2Gesture" in _page()
    other = _page(data="bvh")
    assert "known causes" not in other and "Hand shapes" not in other and "testbed" not in other


def test_all_numbers_stand_beside_the_page():
    rows = list(csv.DictReader(all_numbers(_results()).splitlines()))
    found = {(row["kind"], row["row"], row["metric"]): row for row in rows}
    fgd = found["score", "Trimodal", "fgd"]
    values = [float(fgd[name]) for name in ("value", "low", "high", "clips_low", "clips_high")]
    assert values == pytest.approx([3.02, 2.970, 3.070, 2.92, 3.12], abs=1e-3)
    assert fgd["seeds"] == "0: 3.0; 1: 3.02; 2: 3.04"
    assert found["score", "Trimodal", "talk.semantic_recall"]["value"] == "0.3"
    assert found["score", "Trimodal", "legacy_fgd"]["value"] == "7.5"
    claim = found["difference", "HA2G - Trimodal", "fgd"]
    assert float(claim["value"]) == pytest.approx(-1.01) and claim["verdict"] == "held"
    assert sum(row["kind"] == "run" for row in rows) == 7 * 3


def test_failures_and_missing_rows_leave_the_rest():
    results = _results()
    without = {
        name: {seed: one._replace(scores=None) for seed, one in mine.items()} for name, mine in results.records.items()
    }
    failures = {"HA2G": dict.fromkeys(range(3), "no memory")}
    page = as_markdown(results._replace(records={**results.records, "HA2G": without["HA2G"]}, failures=failures), "")
    assert "- HA2G, seed 1: failed: no memory" in page
    assert _cells(page, "HA2G")[2] == "-" and _cells(page, "HA2G")[-1] == "0"
    assert _cells(page, "Trimodal", "## Claims")[1] == "**undecided** -"
    nothing = as_markdown(results._replace(records=without, failures=failures), "")
    assert "no memory" in nothing and "## Scores" not in nothing


def _gan(with_term, without, fits):
    """The section on the GAN term, from measures by seed and the ratio of the reconstruction terms by seed."""
    truth, results = {"fgd": 0.0, "jerk_ratio": 1.0, "diversity_l1": 40.0}, _results(seeds=len(fits))
    records = dict(results.records)
    for name, mine, terms in (("HA2G", with_term, fits), ("HA2G without GAN", without, [1.0] * len(fits))):
        for seed, (values, term) in enumerate(zip(mine, terms, strict=True)):
            scores = _scores(0.0, 0.3)
            rows = scores["splits"]["test"]["evaluation"]["rows"]
            for row, measures in (("model", truth | (values or {})), ("ground truth", truth)):
                rows[row] = {metric: {"value": value, "low": None, "high": None} for metric, value in measures.items()}
            validation = [] if term is None else [{"step": 50, "validation/loss/huber": term}]
            record = records[name][seed]._replace(validation=validation, scores=None if values is None else scores)
            records[name] = {**records[name], seed: record}
    page = as_markdown(results._replace(records=records), "")
    section = page[page.index("## The GAN term") : page.index("## Runs")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines() if line[:1] == "|"]
    return {cell[0]: cell[-1] for cell in cells[2:]}, section


def test_nearer_is_less_distance_on_either_side_of_the_truth():
    jerks = [{"jerk_ratio": 1.1 + 0.01 * seed, "diversity_l1": 45.0 + seed} for seed in range(3)]
    said, section = _gan(jerks, [{"jerk_ratio": 0.5, "diversity_l1": 38.0}] * 3, [1.03, 1.05, 1.04])
    assert said == {"jerk / truth": "nearer", "FGD": "undecided", "Diversity (L1)": "farther"}
    assert "changes by +4.0% [+1.5%, +6.5%] with the GAN term. The GAN term **helps**." in section


@pytest.mark.parametrize(
    ("jerks", "fit", "sentence"),
    [
        ([0.9, 0.4, 1.3], 1.0, "**was not shown to help**"),
        ([0.9, 0.91, 0.92], 1.06, "changes by +6.0% [+6.0%, +6.0%] with the GAN term. The GAN term **was not shown"),
        ([0.9, 0.91, 0.92], 0.9, "changes by -10.0% [-10.0%, -10.0%] with the GAN term. The GAN term **helps**"),
    ],
)
def test_noise_or_a_worse_fit_is_no_help_but_a_better_fit_is(jerks, fit, sentence):
    _, section = _gan([{"jerk_ratio": jerk} for jerk in jerks], [{"jerk_ratio": 0.5}] * 3, [fit] * 3)
    assert sentence in section


def test_draws_of_no_pairs_or_of_no_diversity_have_no_range():
    def verdict(*draws: float) -> str:
        return tables.draws_verdict({"HA2G": {0: {"splits": {"val": {"draws": {"model": list(draws)}}}}}}, "val")

    assert verdict().startswith("No two windows are of different recordings")
    assert verdict(0.0, 0.0).startswith("All draws are the same")
    assert verdict(1.0, 2.0).startswith("The widest range is 66.67%")
