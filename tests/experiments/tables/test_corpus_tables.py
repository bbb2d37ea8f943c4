"""Tables 5 and 10 have the paper's numbers and those of the corpus."""

import shutil

import pytest
from tables.corpus_tables import corpus_report

from ha2g_jax.data.corpus import Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.corpus.statistics import summarise


def _cells(report, row):
    line = next(line for line in report.splitlines() if line.startswith(f"| {row} "))
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_table_5_counts_the_corpus_beside_the_paper_s(tiny_talk):
    report = corpus_report("table5", tiny_talk, "reproduce table5")
    total = summarise(tiny_talk)["total"]
    assert _cells(report, "TED-Expressive, paper") == ["TED-Expressive, paper", "1,764", "100.8", "240,447", "21 %"]
    numbers = [f"{total['recordings']:,}", f"{total['hours']:,.3f}", f"{total['windows']:,}", "-"]
    assert _cells(report, "this corpus, all splits")[1:] == numbers
    splits = Corpus.open(tiny_talk).splits
    assert sum(int(_cells(report, f"this corpus, {split}")[3].replace(",", "")) for split in splits) == total["windows"]


def test_table_10_has_the_angles_of_the_corpus_and_of_the_paper(tiny_talk):
    report = corpus_report("table10", tiny_talk, "reproduce table10")
    found = summarise(tiny_talk)["training"]["joints"]["left_elbow"]["corpus"]
    cells = _cells(report, "left elbow")
    assert cells[1:3] == [f"{found['mean']:.1f}", f"{found['std']:.1f}"] and cells[5] == "75.1"


def test_a_corpus_without_training_has_no_table_10(tiny_talk, tmp_path):
    path = shutil.copytree(tiny_talk, tmp_path / "corpus")
    metadata = path / "dataset.json"
    metadata.write_text(metadata.read_text().replace('"train"', '"other"'))
    with pytest.raises(UserError, match="no training split"):
        corpus_report("table10", path, "")
