"""The scores as a table to read."""

from typing import Any

COLUMNS = {
    "beat_f1": "beat F1",
    "beat_f1_strict": "strict F1",
    "beat_recall": "recall",
    "beat_precision": "precision",
    "beats_per_second": "beats/s",
    "semantic_recall": "hand shape",
    "style_amplitude": "amplitude r",
    "style_handedness": "handedness r",
}
_NAME_WIDTH, _WIDTH = 18, 13


def as_table(scores: dict[str, Any]) -> str:
    """What `study.talk.evaluate` returns, as text: value and standard error in each cell."""
    lines = [
        f"{scores.get('checkpoint', 'model')} ({scores['model']}) on {scores['data']['name']}, seed {scores['seed']}; "
        f"{scores['num_test_words']} test words; value ± standard error, by clip (style: by speaker)"
    ]
    for split, result in scores["splits"].items():
        lines += ["", *_split_lines(split, result)]
    if scores["probe"]:
        lines += ["", "Word class from frozen f_high at word onsets, by a linear probe"]
    for split, row in scores["probe"].items():
        lines.append(f"  {split:<22}{_cell(row['accuracy'])}  (most frequent class {_cell(row['majority']).strip()})")
    return "\n".join(lines)


def _split_lines(split: str, result: dict[str, Any]) -> list[str]:
    lines = [
        f"{split}: {result['num_clips']} clips, {result['num_speakers']} speakers, {result['num_strokes']} beats, "
        f"{result['num_words']} words",
        "".join([" " * _NAME_WIDTH, *(f"{title:>{_WIDTH}}" for title in COLUMNS.values())]),
    ]
    for name, row in result["rows"].items():
        lines.append("".join([f"{name:<{_NAME_WIDTH}}", *(_cell(row.get(key)) for key in COLUMNS)]))
    for title, key in (("beat F1", "beat_f1_gain"), ("strict F1", "beat_f1_strict_gain")):
        gain = result[key]
        if gain["value"] is not None and gain["error"]:
            errors = f"{gain['value'] / gain['error']:.1f} standard errors"
            lines.append(f"{title} over mismatched speech: {_cell(gain).strip()}, {errors}")
    return lines


def _cell(estimate: dict[str, float | None] | None) -> str:
    if estimate is None or estimate["value"] is None:
        return f"{'-':>{_WIDTH}}"
    error = "" if estimate["error"] is None else f" ±{estimate['error']:.2f}"
    return f"{estimate['value']:.2f}{error}".rjust(_WIDTH)
