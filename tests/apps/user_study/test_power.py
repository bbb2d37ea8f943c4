"""Powers agree with closed forms where there are some, and with the analysis of answers; pilots give what made them."""

import json

import numpy as np
import pytest
from fixtures.simulated_study import make_answers, write_study
from scipy import stats

from ha2g_jax import cli
from ha2g_jax.apps.user_study import power
from ha2g_jax.apps.user_study.answers import Choices
from ha2g_jax.apps.user_study.estimates import system_differences
from ha2g_jax.apps.user_study.power import Plan, Spreads, read_pilot
from ha2g_jax.errors import UserError


def power_of(simulate, participants, simulations=1000):
    return simulate(np.random.default_rng(0), simulations, participants).mean()


def test_power_of_a_difference_that_varies_over_participants_alone_is_that_of_the_t_test():
    """The share of studies with p < 0.05 in the right direction, from the noncentral t distribution."""
    simulate = power.of_difference(0.3, Spreads(0.5, 0.0, 1e-9), Plan(8, 8))
    for participants in (10, 25):
        limit = stats.t.ppf(0.975, participants - 1)
        expected = stats.nct.sf(limit, participants - 1, 0.3 / 0.5 * np.sqrt(participants))
        assert power_of(simulate, participants, 2000) == pytest.approx(expected, abs=0.04)


def test_simulated_studies_are_analysed_as_answers_are():
    """Studies of the same kind, drawn as ratings and analysed by least squares, find the difference as often."""
    random, found = np.random.default_rng(1), 0
    for _ in range(200):
        own, clip = random.normal(0, 0.3, (12, 2, 1)), random.normal(0, 0.15, (1, 2, 6))
        table = np.array([0.6, 0])[:, None] + own / np.sqrt(2) + clip / np.sqrt(2) + random.normal(0, 0.8, (12, 2, 6))
        participants, systems, clips = np.nonzero(np.isfinite(table))
        found += system_differences(table.ravel(), participants, clips, systems, 2).low[0] > 0
    simulate = power.of_difference(0.6, Spreads(0.3, 0.15, 0.8), Plan(6, 6))
    assert power_of(simulate, 12) == pytest.approx(found / 200, abs=0.1)


def test_no_effect_is_found_in_at_most_the_share_of_the_level():
    """Of nearly no effect, as often as intervals miss the truth to one side: at most 2.5 %, up to chance."""
    assert power_of(power.of_difference(1e-9, Spreads(0.3, 0.2, 0.8), Plan(6, 6)), 15) < 0.04
    assert power_of(power.of_share(0.5 + 1e-9, Spreads(0.1, 0.05), Plan(6, 6, 0.2)), 15) < 0.04


def test_shares_have_the_mean_and_the_spread_that_are_asked_for():
    spread = power._logit_spread(0.6, 0.12)
    shares = 1 / (1 + np.exp(-np.random.default_rng(0).normal(power._centre(0.6, spread), spread, 200_000)))
    assert (shares.mean(), shares.std()) == pytest.approx((0.6, 0.12), abs=2e-3)


def test_nearly_all_may_choose_alike():
    for share in (0.001, 0.999):
        assert 0 <= power_of(power.of_share(share, Spreads(0.01, 0.0), Plan(6, 6)), 15) <= 1


def test_power_grows_with_participants_and_the_smallest_number_is_found():
    simulate = power.of_difference(0.4, Spreads(0.4, 0.1, 0.8), Plan(10, 10))
    rows, smallest = power.required_participants(simulate, 0.8, clips=10, most=200)
    assert smallest is not None and rows[smallest] >= 0.8 > rows[smallest - 1]
    assert rows[5] < rows[10] < rows[smallest]


def test_more_participants_do_not_replace_clips():
    simulate = power.of_difference(0.3, Spreads(0.1, 0.6, 0.5), Plan(4, 4))
    rows, smallest = power.required_participants(simulate, 0.8, clips=4, most=60)
    assert smallest is None and max(rows) == 60


def test_corrections_and_equal_choices_cost_power():
    plans = Plan(10, 10), Plan(10, 10, comparisons=6), Plan(10, 10, equal=0.4), Plan(10, 4)
    alone, *others = (power_of(power.of_share(0.65, Spreads(0.05, 0.05), plan), 30) for plan in plans)
    assert max(others) < alone - 0.05


@pytest.mark.parametrize(
    ("of", "effect", "spreads", "plan"),
    [
        (power.of_difference, np.nan, Spreads(1, 1, 1), Plan(5, 5)),
        (power.of_difference, 1, Spreads(1, 1, 1), Plan(5, 6)),
        (power.of_difference, -4.1, Spreads(1, 1, 1), Plan(5, 5)),
        (power.of_difference, 1, Spreads(0, 0, 0), Plan(5, 5)),
        (power.of_share, 0.95, Spreads(0.4, 0), Plan(5, 5)),
        (power.of_share, 0.6, Spreads(0, 0), Plan(5, 5, equal=1)),
    ],
)
def test_numbers_out_of_range(of, effect, spreads, plan):
    with pytest.raises(UserError):
        of(effect, spreads, plan)


def test_a_pilot_gives_the_spreads_that_made_it(tmp_path):
    """40 participants, 12 clips: between participants 0.6 (difference of two times 0.42), rest 0.6 with rounding."""
    key = write_study(tmp_path, 0, num_systems=2, num_clips=12)
    for number in range(40):
        random = np.random.default_rng(number)
        own = random.normal(0, 0.6 / np.sqrt(2), 2)

        def score(system, clip, own=own, random=random):
            return 3.2 - 0.3 * system + own[system] + random.normal(0, 0.6)

        content = make_answers(key, f"p{number}", random, score=score, matched=0.5 + 0.3 * (number % 2), equal=0.25)
        (tmp_path / "answers" / f"p{number}.json").write_text(json.dumps(content))
    pilot, _ = read_pilot("mos", [tmp_path / "answers"], key)
    assert pilot.participants == pytest.approx(0.6, abs=0.12) and pilot.clips < 0.12
    assert pilot.rest == pytest.approx(np.hypot(0.6, 1 / np.sqrt(12)), abs=0.06)
    shares, equal = read_pilot("mismatch", [tmp_path / "answers"], key)
    assert shares.participants == pytest.approx(0.15, abs=0.06)
    assert equal == pytest.approx(0.25, abs=0.04)


@pytest.mark.parametrize("items", [2, 4, 10])
def test_pilots_of_choices_give_the_spread_of_participants_on_average(items):
    """60 participants who choose for some of 20 clips; their shares have a standard deviation of 0.2."""
    variances = []
    for number in range(40):
        random = np.random.default_rng(number)
        clips = random.random((60, 20)).argsort(axis=1)[:, :items].ravel()
        people = np.repeat(np.arange(60), items)
        share = 0.5 + random.choice([-0.2, 0.2], 60)[people] + random.choice([-0.1, 0.1], 20)[clips]
        outcome = np.where(random.random(len(clips)) < share, 1, -1)
        systems = np.zeros_like(clips)
        choices = Choices(people, clips, np.arange(len(clips)), systems, systems + 1, outcome)
        variances += power.variances_of_choices(choices)
    of_participants, of_clips, _ = np.mean(variances, axis=0)
    assert of_participants == pytest.approx(0.04, abs=0.008) and of_clips == pytest.approx(0.01, abs=0.004)


def test_a_pilot_with_one_choice_of_each_participant_tells_nothing():
    people = np.arange(60)
    choices = Choices(people, people % 20, people, 0 * people, 0 * people + 1, np.where(people % 3, 1, -1))
    assert power.variances_of_choices(choices) == []


def test_command(tmp_path, capsys):
    mos = ["study", "power", "mos", "--difference", "0.5", "--most", "60"]
    spreads = ["--sd-participants", "0.3", "--sd-clips", "0.1", "--sd-rest", "0.8"]
    assert cli.main([*mos, *spreads]) == 0
    assert "participants reach a power of 0.8" in capsys.readouterr().out
    write_study(tmp_path, 6)
    pilot = ["--pilot", str(tmp_path / "answers"), "--study", str(tmp_path / "study")]
    assert cli.main([*mos, *pilot, "--sd-clips", "0.1"]) == 0
    assert "0.1 between clips" in capsys.readouterr().out
    share = ["study", "power", "mismatch", "--share", "0.7", "--most", "60", *pilot]
    assert cli.main(share) == 0
    for wrong in (mos, [*share, "--sd-rest", "1"], ["study", "power", "mos", "--share", "0.6"], share[:-2]):
        assert cli.main(wrong) == 2
    write_study(tmp_path / "one", 1)
    one = ["--pilot", str(tmp_path / "one" / "answers"), "--study", str(tmp_path / "one" / "study")]
    assert cli.main([*mos, *one]) == 2 and "too few answers" in capsys.readouterr().err
