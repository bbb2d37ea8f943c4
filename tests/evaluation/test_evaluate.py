"""An evaluation always shows what its scores are worth: sanity rows, intervals, flags, and refusals to compare."""

import dataclasses
from typing import Any, cast

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.evaluate import compare, evaluate
from ha2g_jax.evaluation.remarks import beat_rates, won_metrics
from ha2g_jax.evaluation.rows import make_rows
from ha2g_jax.metrics.row import Cut, choose_cut
from ha2g_jax.metrics.sanity import (
    FROZEN,
    HALF,
    JITTER,
    MEAN_POSE,
    MISMATCHED,
    SANITY_ROWS,
    SMOOTHED,
    TRUTH,
)

CLIPS, DRAWS = 24, 100


@pytest.fixture(scope="module")
def reference(perform):
    return perform(CLIPS)


@pytest.fixture(scope="module")
def results(skeleton, perform, reference, features):
    late = perform(CLIPS, delay=0.25, borders=(30, 60, 90))
    rows = {"late": late, "late again": late}
    return evaluate(rows, reference, skeleton, autoencoder=features, draws=DRAWS)


def value(results, row, metric):
    return results["rows"][row][metric]["value"]


def test_sanity_rows_stand_beside_every_method(results):
    assert list(results["rows"]) == ["late", "late again", *SANITY_ROWS]
    for name in results["rows"]:
        assert results["rows"][name], name
    for name in {"late", *SANITY_ROWS} - {HALF}:
        assert {"beat_gain", "fgd", "diversity_l1", "speed_hellinger", "jerk_ratio"} <= results["rows"][name].keys()


def test_ground_truth_is_at_no_distance_from_itself(results):
    assert value(results, TRUTH, "fgd") == pytest.approx(0, abs=1e-9)
    assert value(results, TRUTH, "speed_hellinger") == value(results, TRUTH, "joint_mae") == 0
    assert value(results, TRUTH, "pck") == value(results, TRUTH, "jerk_ratio") == 1
    assert value(results, MISMATCHED, "fgd") == pytest.approx(0, abs=1e-9)
    assert 0 < value(results, HALF, "fgd") < value(results, MEAN_POSE, "fgd")


def test_the_seed_pose_is_not_scored(results, skeleton, perform, reference, features):
    spoilt = perform(CLIPS, delay=0.25, borders=(30, 60, 90))
    for clip in spoilt:
        clip.directions[:4] = np.roll(clip.directions[:4], 1, axis=-1)
    again = evaluate({"late": spoilt}, reference, skeleton, autoencoder=features, draws=2)
    values = {name: score["value"] for name, score in again["rows"]["late"].items()}
    assert values == {name: score["value"] for name, score in results["rows"]["late"].items()}


def test_several_motions_for_one_speech_have_their_distance(skeleton, perform, features):
    """Nothing where all are alike; else between them alone, whatever separates one speech from another."""
    reference, others = perform(12), perform(12, delay=0.25)
    rows = {"one": reference, "same": [*reference, *reference], "two": [*reference, *others]}
    results = evaluate(rows, reference, skeleton, autoencoder=features, draws=20)
    assert "multimodality" not in results["rows"]["one"]
    assert value(results, "same", "multimodality") == 0
    cut = choose_cut([clip.num_frames for clip in reference], 34)
    assert cut is not None
    ours, theirs = (
        features(
            np.stack([clip.directions[start : start + 34] for clip in clips for start in cut.starts(clip.num_frames)])
        )
        for clips in (reference, others)
    )
    expected = np.abs(ours - theirs).sum(axis=1).mean()
    assert value(results, "two", "multimodality") == pytest.approx(expected, rel=1e-4)
    assert (
        0 < results["rows"]["two"]["multimodality"]["low"] < expected < results["rows"]["two"]["multimodality"]["high"]
    )


def test_only_motion_that_meets_its_own_speech_gains(results):
    rows = results["rows"]
    assert rows[TRUTH]["beat_gain"]["low"] > 0.1
    for name in (JITTER, MISMATCHED):
        assert rows[name]["beat_gain"]["low"] < 0 < rows[name]["beat_gain"]["high"]
    assert rows["late"]["beat_gain"]["high"] < 0
    assert value(results, MEAN_POSE, "beat_f") == value(results, FROZEN, "beat_f") == 0
    assert results["counts"][FROZEN]["num_still"] == CLIPS


def test_smoothing_moves_less_and_jitter_more(results):
    assert value(results, SMOOTHED, "jerk_ratio") < 0.9
    assert value(results, JITTER, "jerk_ratio") > 2
    assert value(results, FROZEN, "l1_diversity") == pytest.approx(0, abs=1e-9)


def test_jitter_gives_itself_away_and_the_true_motion_later_does_not(results):
    assert value(results, JITTER, "told_by_smoothness") > 0.95
    assert abs(value(results, "late", "told_by_smoothness") - 0.5) < 0.2
    assert not {"told_by_all"} & {*results["rows"][TRUTH], *results["rows"][MISMATCHED]}


def test_an_angle_that_never_bends_has_no_limits(skeleton, perform):
    reference = perform(6)
    elbow = skeleton.bone("left_wrist")
    for clip in reference:  # the forearm goes straight on from the upper arm
        clip.directions[:, elbow] = clip.directions[:, skeleton.bone("left_elbow")]
    folded = perform(6)
    for clip in folded:
        clip.directions[:, skeleton.bone("right_wrist")] = -clip.directions[:, skeleton.bone("right_elbow")]
    results = evaluate({"bends": perform(6), "folded": folded}, reference, skeleton, draws=2)
    assert value(results, "bends", "limits_worst") < 0.1
    assert value(results, "folded", "limits_worst") > 0.9


def test_a_row_has_the_scores_that_its_motion_allows(results):
    assert "joint_mae" not in results["rows"][MISMATCHED] and value(results, "late", "joint_mae") > 0
    assert "seam_velocity" not in results["rows"][TRUTH]  # whose windows have no borders
    assert value(results, "late", "seam_velocity") == pytest.approx(1, abs=0.3)


def test_differences_are_those_of_the_values_that_are_shown(skeleton, perform, features):
    """Also of diversity, whose value is a mean of ten draws of 500 pairs: 15 clips have 810."""
    reference = perform(15)
    rows = {"late": perform(15, delay=0.25), "true": reference}
    results = evaluate(rows, reference, skeleton, autoencoder=features, draws=2)
    (found,) = results["differences"].values()
    for metric in ("beat_gain", "fgd", "diversity_l1"):
        difference = value(results, "true", metric) - value(results, "late", metric)
        assert found[metric]["value"] == pytest.approx(difference, abs=1e-4)


def test_differences_of_two_methods_are_paired(results):
    (found,) = results["differences"].values()
    assert list(results["differences"]) == ["late again - late"]
    for metric in ("beat_gain", "fgd", "jerk"):
        assert found[metric] == {"value": 0, "low": 0, "high": 0}


def test_a_metric_that_a_sanity_row_wins_is_flagged(results):
    rows = {name: {"beat_f": {"value": 0.5}} for name in results["rows"]}
    assert not won_metrics(rows)
    rows[JITTER] = {"beat_f": {"value": 0.6}}
    (flag,) = won_metrics(rows)
    assert "white jitter (0.600) higher than ground truth (0.500)" in flag
    assert any("white jitter" in flag and "BEAT alignment" in flag for flag in results["flags"])


def test_beats_far_too_often_are_flagged():
    rows = {name: {"beats_per_second": {"value": 1.0}} for name in ("busy", "fine", *SANITY_ROWS)}
    rows["busy"] = {"beats_per_second": {"value": 1.31}, "jerk_ratio": {"value": 4.6}}
    rows["lazy"] = {"beats_per_second": {"value": 0.49}}
    assert beat_rates(rows, ["busy", "fine", "lazy"]) == [
        "busy: 1.31 beats/s, ground truth 1.00, and 4.6 times its jerk: its F and BC are those of dense beats",
        "lazy: 0.49 beats/s, ground truth 1.00: far fewer, whatever the F",
    ]


def test_the_same_seed_gives_the_same_results(skeleton, perform, features):
    late, reference = perform(6, delay=0.25, borders=(30, 60, 90)), perform(6)
    rows = {"late": late, "late again": late}
    first, again = (evaluate(rows, reference, skeleton, autoencoder=features, draws=10) for _ in range(2))
    assert first == again


def test_without_an_autoencoder_it_says_how_to_train_one(skeleton, perform):
    results = evaluate({"late": perform(6, delay=0.25)}, perform(6), skeleton, draws=2)
    assert not {"fgd", "diversity_l1"} & results["rows"]["late"].keys()
    assert results["autoencoder"] is None
    assert any("ha2g train --config" in note for note in results["notes"])


def test_without_sound_beats_are_left_out_and_that_is_said(skeleton, perform):
    mute = [dataclasses.replace(clip, onsets=None) for clip in perform(6)]
    results = evaluate({"mute": mute}, mute, skeleton, draws=2)
    assert "beat_f" not in results["rows"]["mute"]
    assert value(results, "mute", "acceleration") > 0
    assert "6 of 6 clips have no sound" in " ".join(results["notes"])


def test_onsets_may_be_a_list(skeleton, perform):
    clips = perform(3)
    listed = [dataclasses.replace(clip, onsets=cast(Any, clip.onsets.tolist())) for clip in clips]
    arrays, lists = (evaluate({"same": given}, given, skeleton, draws=2) for given in (clips, listed))
    assert value(arrays, "same", "beat_f") == value(lists, "same", "beat_f") > 0


def test_silent_clips_are_counted_and_not_scored(skeleton, perform):
    clips = perform(9)
    quiet = [dataclasses.replace(clip, onsets=np.zeros(0)) if number < 3 else clip for number, clip in enumerate(clips)]
    results = evaluate({"same": quiet}, quiet, skeleton, draws=2)
    assert results["counts"][TRUTH]["num_silent"] == 3
    assert results["counts"][TRUTH]["num_used"] == 6
    heard = [np.sum(clip.onsets >= 4 / clip.fps) for clip in quiet[3:]]
    assert results["counts"][TRUTH]["onsets_per_second"] == pytest.approx(sum(heard) / (6 * 116 / 15))
    assert value(results, TRUTH, "beats_per_second_in_silence") > 0


def test_windows_leave_the_seed_pose_out_where_clips_are_long_enough(skeleton, perform, features):
    for num_frames, name, windows in ((38, "fgd", 6), (37, "fgd_seeded", 6), (72, "fgd", 12)):
        clips = perform(6, num_frames)
        results = evaluate({"same": clips}, clips, skeleton, autoencoder=features, draws=2)
        assert name in results["rows"]["same"]
        assert results["data"]["windows"] == windows
    assert "FGD (seeded)" not in " ".join(results["warnings"])
    assert list(Cut("fgd", 4, 34).starts(72)) == [4, 38] and choose_cut([33, 20], 34) is None


def test_few_windows_are_warned_of(skeleton, perform, features):
    few, many = (
        evaluate({"a": clips}, clips, skeleton, autoencoder=features, draws=2) for clips in (perform(6), perform(30))
    )
    assert "less than 10 times" in " ".join(few["warnings"])
    assert not many["warnings"]


def test_motion_is_cut_to_the_common_length_and_counted(skeleton, perform):
    short, long = perform(6, 60), perform(6, 120)
    results = evaluate({"short": short}, long, skeleton, draws=2)
    assert results["data"]["seconds"] == 6 * 4
    assert "clips whose reference was cut to the length of the motion: 6, by 24.0 s in all" in results["notes"]
    results = evaluate({"long": long}, short, skeleton, draws=2)
    assert "long: clips whose motion was cut to the length of the shortest: 6, by 24.0 s in all" in results["notes"]


def test_several_performances_of_a_clip_are_all_scored(skeleton, perform):
    first, second = perform(6, delay=0.0), perform(6, delay=0.25)
    both, one, other = (evaluate({"a": clips}, first, skeleton, draws=2) for clips in (first + second, first, second))
    mean = (value(one, "a", "acceleration") + value(other, "a", "acceleration")) / 2
    assert value(both, "a", "acceleration") == pytest.approx(mean)


def test_one_source_has_no_intervals_and_says_so(skeleton, perform, features):
    clips = [dataclasses.replace(clip, recording="only") for clip in perform(4)]
    results = evaluate({"a": clips}, clips, skeleton, autoencoder=features, draws=2)
    assert results["rows"]["a"]["beat_f"]["low"] is None
    assert results["rows"]["a"].get("beat_gain", {"value": None})["value"] is None
    assert results["rows"][HALF] == {}
    assert "one recording" in " ".join(results["warnings"])


def test_intervals_over_few_recordings_are_warned_of(skeleton, perform):
    few, many = (evaluate({"a": clips}, clips, skeleton, draws=2)["warnings"] for clips in (perform(27), perform(30)))
    assert "intervals of 9 recordings are too narrow" in " ".join(few) and not many


def test_what_cannot_be_evaluated_is_refused(skeleton, perform, features):
    clips = perform(6)

    def attempt(rows, reference=clips, **options):
        return evaluate(rows, reference, skeleton, draws=2, **options)

    with pytest.raises(UserError, match="nothing to evaluate"):
        attempt({})
    with pytest.raises(UserError, match="one rate at a time"):
        attempt({"a": [dataclasses.replace(clip, fps=30.0) for clip in clips]})
    for change in (lambda vectors: 3 * vectors, lambda vectors: vectors - skeleton.mean_directions):
        wrong = [dataclasses.replace(clip, directions=change(clip.directions)) for clip in clips]
        for rows in (({"a": wrong},), ({"a": clips}, wrong)):
            with pytest.raises(UserError, match=r"clip0 has direction vectors of length .*, not 1; add the mean pose"):
                attempt(*rows)
    with pytest.raises(UserError, match="auto-encoder is of the skeleton ted_gesture at 30"):
        attempt({"a": clips}, autoencoder=dataclasses.replace(features, fps=30.0))


def test_results_of_two_autoencoders_are_not_compared(results):
    other = results | {"autoencoder": results["autoencoder"] | {"id": "f" * 64}}
    with pytest.raises(UserError, match=r"0123456789abcdef, the other of ffffffffffffffff.*cannot be compared"):
        compare(results, other)
    with pytest.raises(UserError, match="skeleton"):
        compare(results, results | {"data": results["data"] | {"skeleton": "ted_expressive"}})
    same = compare(results, results)
    assert same["late"]["fgd"]["difference"] == 0
    assert same["late"]["fgd"]["first"] == results["rows"]["late"]["fgd"]


def test_mismatched_speech_is_another_sources(skeleton, perform, reference):
    rows = make_rows({"a": reference}, reference, skeleton)
    for number, onsets in enumerate(rows.rows[MISMATCHED].onsets):
        others = [other for other, own in enumerate(rows.truth.onsets) if np.array_equal(own, onsets)]
        assert others and rows.reference.recordings[others[0]] != rows.reference.recordings[number]
        assert rows.rows[MISMATCHED].directions[number] is rows.truth.directions[number]


@pytest.mark.parametrize("num_recordings", [2, 3])
def test_the_chance_level_of_mismatched_speech_is_that_of_the_true_motion(skeleton, perform, num_recordings):
    """With few recordings, the other sound of a clip's other sound is often its own."""
    results = evaluate({"a": perform(3 * num_recordings)}, perform(3 * num_recordings), skeleton, draws=2)
    assert value(results, MISMATCHED, "beat_f_mismatched") == value(results, TRUTH, "beat_f_mismatched")


def test_where_one_recording_alone_has_windows_they_are_told_apart_by_blocks_of_its_time(skeleton, perform):
    """Those of 5 s; its blocks are not taken for recordings, of which others have no such window."""
    first, *others = (perform(4, 450, delay=delay) for delay in (0.0, 0.25))
    rows = [
        [
            dataclasses.replace(clip, directions=clip.directions[: 60 if index != 2 else None])
            for index, clip in enumerate(clips)
        ]
        for clips in (first, *others)
    ]
    alone = evaluate({"late": rows[1][2:3]}, rows[0][2:3], skeleton, draws=2)
    found = evaluate({"late": rows[1]}, rows[0], skeleton, draws=2)
    told = {name: score for name, score in found["rows"]["late"].items() if name.startswith("told_by")}
    assert any("only one recording has 5 s of motion" in warning for warning in found["warnings"])
    assert told and told == {name: alone["rows"]["late"][name] for name in told}
