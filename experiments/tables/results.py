"""Results of a reproduction, of which the report is made."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from tables.paper_tables import Table
from tables.tables import RowScores


class RunState(NamedTuple):
    """State of a training.

    Attributes:
        row: name of the row.
        seed: seed of the run.
        name: name of the run and of its folder.
        steps: number of steps of the complete training.
        batch_size: number of windows in a step.
        last_step: last step of the training so far.
        scored_step: step of the checkpoint that was scored, None without one.
        validation: term on the validation split by which that checkpoint was chosen, None where it was not logged.
    """

    row: str
    seed: int
    name: str
    steps: int
    batch_size: int
    last_step: int
    scored_step: int | None
    validation: float | None


class Results(NamedTuple):
    """Content of the report.

    Attributes:
        table: table of the paper.
        name: name of the table, as in `TABLES`.
        data: data set of the request.
        size: size of the request.
        splits: splits that were scored.
        scores: name of a row -> seed -> scores of `run_scores`.
        failures: name of a row -> seed -> reason in one line.
        left_out: name of a row that lacks an input -> reason.
        runs: states of the runs of all rows.
        facts: title -> text, printed in this order.
        autoencoder: description of the pose auto-encoder.
        has_legacy: whether legacy scores were requested.
    """

    table: Table
    name: str
    data: str
    size: str
    splits: tuple[str, ...]
    scores: RowScores
    failures: Mapping[str, Mapping[int, str]]
    left_out: Mapping[str, str]
    runs: Sequence[RunState]
    facts: Mapping[str, str]
    autoencoder: str
    has_legacy: bool
