"""The report has the paper's numbers beside ours, verdicts and caveats that follow from what was run."""

from typing import Any

import pytest
from tables import paper_tables, tables
from tables.report import as_markdown, caveats, figure
from tables.results import Results, RunState


def _three(value, spread=0.1):
    return {"value": value, "low": value - spread, "high": value + spread}


def _score(value: float | None, error: float | None = 0.01) -> dict[str, Any]:
    bounds = (None, None) if value is None or error is None else (value - 1.96 * error, value + 1.96 * error)
    return {"value": value, "low": bounds[0], "high": bounds[1], "error": error}


def _scores(fgd, recall, gain=0.2):
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
    table = paper_tables.table(name, data)
    scores = {
        row.name: {
            seed: _scores(2.0 + 0.01 * seed if row.name == table.reference else 3.0 + 0.02 * seed, 0.3)
            for seed in range(seeds)
        }
        for row in table.rows
    }
    runs = [
        RunState(row.name, seed, f"run-{row.method}-{seed}", (steps or {}).get(row.name, 100), 4, 100, 50, 0.25)
        for row in table.rows
        for seed in range(seeds)
    ]
    facts = {"command": "`reproduce`", "commit": "abc"}
    values = Results(table, name, data, size, ("test",), scores, {}, {}, runs, facts, "id cafe; step 5", False)
    return values._replace(**changes)


def _cells(report, row, heading="## Split test"):
    """The cells of a line of the first table after a heading."""
    lines = report[report.index(heading) :].splitlines()
    return next(
        [cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith(f"| {row} |")
    )


def test_the_paper_s_numbers_stand_beside_ours():
    cells = _cells(as_markdown(_results()), "Trimodal")
    assert cells[1] == "12.61" and cells[3] == "0.592" and cells[9] == "154.1" and cells[11] == "3"
    # 3.02 with a t interval of 4.3027 x 0.02 / sqrt(3), and the mean of the intervals over clips.
    assert cells[2] == "3.020 [2.970, 3.070] (2.920, 3.120)"
    assert cells[5] == "0.200 [0.200, 0.200] (0.100, 0.300)"
    assert _cells(as_markdown(_results()), "Ground Truth")[1:3] == ["0.000", "0.000 (-0.100, 0.100)"]
    assert _cells(as_markdown(_results()), r"*white jitter*")[1:3] == ["", "99.00 (98.90, 99.10)"]


def test_claims_have_verdicts():
    report = as_markdown(_results())
    claims = [line for line in report.splitlines() if line.startswith("| HA2G ahead of Trimodal |")]
    assert len(claims) == 4
    assert claims[0].startswith(
        "| HA2G ahead of Trimodal | FGD | -7.307 | -1.010 [-1.136, -0.884] | <0.001 | 3 | **held** |"
    )
    assert "| +0.123 (BC) | 0.000 [0.000, 0.000] | 1.000 | 3 | **undecided** |" in claims[1]
    assert "fingers r" in claims[3] and "**undecided**" in claims[3]
    assert "HA2G ahead of HA2G |" not in report


def test_comparable_rows_are_not_claimed_to_be_behind():
    report = as_markdown(_results("table3"))
    (line,) = (line for line in report.splitlines() if line.startswith("| HA2G Full about as good as HA2G-ASR | FGD"))
    assert line.endswith("| **not held** |")


def test_known_causes_are_only_talk_s():
    report = as_markdown(_results())
    cells = _cells(report, "HA2G", "### Against the known causes")
    assert [cell[:5] for cell in cells[4:8]] == ["0.400", "0.300", "0.120", "0.180"]
    assert cells[8] == "-"
    ceiling = _cells(report, r"*teacher (ceiling)*", "### Against the known causes")
    assert len(ceiling) == len(cells) and ceiling[1].startswith("0.900") and ceiling[5].startswith("0.800")
    assert "- Trimodal: above the floors (0.180" in report
    other = as_markdown(_results(data="bvh"))
    assert "known causes" not in other and "semantic" not in other and "testbed" not in other


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({}, "Talk is a testbed made by a program: these numbers do not describe people."),
        ({}, "can be compared with no other's"),
        ({"size": "debug"}, "its numbers say nothing about the methods"),
        ({"seeds": 1}, "1 seed a row: too few"),
        ({"steps": {"Trimodal": 5000}}, "Budgets differ: 400, 20,000 windows of training."),
        ({"failures": {"Trimodal": {0: "bad"}}}, "Runs without scores: 1 of 21"),
        ({}, "24 differences are looked at; those of each table of claims are corrected"),
    ],
)
def test_caveats_follow_from_facts(changes, sentence):
    text = " ".join(caveats(_results(**changes)))
    assert text.count(sentence) == 1


def test_remarks_are_of_what_is_shown():
    report = as_markdown(_results())
    for remark in ("diversity L1: white jitter (44.00) higher", "Trimodal, seed 2: 9.00 beats/s, far"):
        assert report.count(f"- test: {remark}") == 1
    assert "R: white jitter" not in report


def test_claims_are_counted():
    table, scores = _results().table, _results().scores
    tally = tables.tally(table, scores, "test", tables.CLAIMED)
    assert tally == "FGD 6 held; beat gain 6 undecided"
    assert f"- test: {tally}; " in as_markdown(_results())


def test_caveats_are_absent_without_cause():
    text = " ".join(caveats(_results(data="ted_gesture", size="paper")))
    for sentence in ("testbed", "size", "too few", "Budgets", "no scores", "unfinished"):
        assert sentence not in text.replace("not in size with", "")


def test_failures_and_missing_rows_leave_the_rest():
    results = _results()
    scores = {name: mine for name, mine in results.scores.items() if name != "HA2G"}
    report = as_markdown(results._replace(scores=scores, failures={"HA2G": dict.fromkeys(range(3), "no memory")}))
    assert "- HA2G, seed 1: failed: no memory" in report
    assert _cells(report, "HA2G")[2] == "-" and _cells(report, "HA2G")[11] == "0, 3 failed"
    assert "| HA2G ahead of Trimodal | FGD | -7.307 | - | - | 0 | **undecided** |" in report
    nothing = as_markdown(results._replace(scores={}, failures={"HA2G": {0: "no memory"}}))
    assert "no memory" in nothing and "## Split" not in nothing


def test_draws_stand_beside_the_paper_s():
    report = as_markdown(_results("table12"))
    paper = _cells(report, "paper, TED-Expressive")
    assert paper[1:3] == ["172.6", "171.9"] and paper[11:] == ["172.9", "1.11%"]
    assert "| HA2G, seed 0 | 30.00 | 30.30 |" in report
    assert "The widest range is 1.00% of the mean, within the paper's." in report


def test_the_figure_has_a_chart_and_a_table():
    results = _results("figure3")
    assert figure(results).count("<polyline") == 3 * 6
    report = as_markdown(results, "figure3.svg")
    assert "](figure3.svg)" in report
    cells = _cells(report, "HA2G")
    assert (cells[1], cells[6], cells[11]) == ("0.600", "0.500", "0.100") and cells[10] == "-" == cells[15]


def test_legacy_scores_are_separate():
    assert "legacy" not in as_markdown(_results())
    report = as_markdown(_results(has_legacy=True))
    assert _cells(report, "HA2G", "By the rules of the public release")[1] == "7.500 [7.500, 7.500]"
