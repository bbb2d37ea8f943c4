"""The `ha2g study` commands `analyse` and `power`: arguments only; each calls one function of the package."""

import argparse
import json
import pathlib
from typing import Any

from ha2g_jax.cli.parser import read_seed
from ha2g_jax.cli.values import positive
from ha2g_jax.errors import UserError


def add_commands(commands: Any) -> None:
    """Add `analyse` and `power` to the commands of `ha2g study`."""
    _add_analyse(commands)
    _add_power(commands)


def _add_analyse(commands: Any) -> None:
    command = commands.add_parser("analyse", help="check answers, and compute scores, preferences and agreement")
    command.description = (
        "Check the answers of participants, leave out those that cannot be used, with the reason, and compute mean "
        "opinion scores, preferences, strengths, the share of matched motion and agreement, with intervals. See "
        "docs/user_study_analysis.md."
    )
    command.add_argument(
        "answers", type=pathlib.Path, nargs="+", metavar="ANSWERS", help="answer files, or folders of .json files"
    )
    command.add_argument("--study", type=pathlib.Path, required=True, metavar="DIR", help="folder of ha2g study make")
    command.add_argument(
        "-o", "--out", type=pathlib.Path, metavar="DIR", help="folder for report.html, report.md and report.json"
    )
    form = command.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print the results as JSON")
    form.add_argument("--markdown", action="store_true", help="print the report as Markdown (default without --out)")
    command.set_defaults(run=_analyse)


def _analyse(arguments: argparse.Namespace) -> None:
    from ha2g_jax.apps.user_study import analysis, writing

    results = analysis.analyse(arguments.answers, arguments.study)
    page = writing.write_report(results, arguments.out) if arguments.out else None
    if arguments.json:
        print(writing.as_json(results))
    elif arguments.markdown or page is None:
        print(writing.as_markdown(results))
    else:
        print(page)


def _add_power(commands: Any) -> None:
    command = commands.add_parser("power", help="compute how many participants a study needs")
    command.description = (
        "Simulate studies and analyse them as ha2g study analyse does, to find the number of participants that shows "
        "an effect. Standard deviations are given, or those of a pilot study. See docs/user_study_analysis.md."
    )
    command.add_argument("measure", choices=("mos", "preference", "mismatch"), help="what the study measures")
    effect = command.add_mutually_exclusive_group(required=True)
    effect.add_argument("--difference", type=float, metavar="D", help="expected difference of mean opinion scores")
    effect.add_argument("--share", type=float, metavar="P", help="expected share, such as 0.6, against a half")
    study = command.add_argument_group("study")
    study.add_argument("--clips", type=positive, default=10, metavar="N", help="number of clips (default: 10)")
    study.add_argument(
        "--items", type=positive, metavar="N", help="number of them that a participant answers (default: all)"
    )
    study.add_argument(
        "--comparisons", type=positive, default=1, metavar="N", help="number of tests to correct for (default: 1)"
    )
    spread = command.add_argument_group("standard deviations of the difference or the share")
    spread.add_argument("--sd-participants", type=float, metavar="SD", help="standard deviation between participants")
    spread.add_argument("--sd-clips", type=float, metavar="SD", help="standard deviation between clips")
    spread.add_argument("--sd-rest", type=float, metavar="SD", help="standard deviation of one rating (mos only)")
    spread.add_argument("--equal", type=float, metavar="P", help="share of choices for neither (default: 0)")
    spread.add_argument(
        "--pilot", type=pathlib.Path, nargs="+", metavar="ANSWERS", help="estimate the other options from these answers"
    )
    spread.add_argument("--study", type=pathlib.Path, metavar="DIR", help="folder of the study of --pilot")
    search = command.add_argument_group("search")
    search.add_argument("--power", type=float, default=0.8, metavar="P", help="power to reach (default: 0.8)")
    search.add_argument("--most", type=positive, default=500, metavar="N", help="most participants (default: 500)")
    search.add_argument(
        "--simulations", type=positive, default=2000, metavar="N", help="simulated studies of a size (default: 2000)"
    )
    search.add_argument("--seed", type=read_seed, default=0, metavar="N", help="seed of the simulations (default: 0)")
    command.add_argument("--json", action="store_true", help="print JSON instead of a table")
    command.set_defaults(run=_power)


def _power(arguments: argparse.Namespace) -> None:
    is_mos = arguments.measure == "mos"
    if is_mos != (arguments.difference is not None):
        raise UserError("mos takes --difference, and preference and mismatch take --share")
    if is_mos and arguments.equal is not None:
        raise UserError("--equal belongs to preference and mismatch")
    if not is_mos and arguments.sd_rest is not None:
        raise UserError("--sd-rest belongs to mos")
    if (arguments.pilot is None) != (arguments.study is None):
        raise UserError("--pilot and --study belong together: answers, and the folder of their study")
    from ha2g_jax.apps.user_study import sample_size
    from ha2g_jax.apps.user_study.analysis import read_study
    from ha2g_jax.apps.user_study.power import Plan, Spreads

    given = [arguments.sd_participants, arguments.sd_clips, arguments.sd_rest if is_mos else 0.0]
    equal = arguments.equal
    if arguments.pilot is not None:
        pilot = sample_size.read_pilot(arguments.measure, arguments.pilot, read_study(arguments.study))
        given = [pilot.spreads[at] if value is None else value for at, value in enumerate(given)]
        equal = pilot.equal if equal is None else equal
    if None in given:
        names = "--sd-participants, --sd-clips and --sd-rest" if is_mos else "--sd-participants and --sd-clips"
        raise UserError(f"give {names}, or the answers of a pilot study: --pilot ANSWERS --study DIR")
    result = sample_size.required_participants(
        arguments.measure,
        arguments.difference if is_mos else arguments.share,
        Spreads(*given),
        Plan(arguments.clips, arguments.items or arguments.clips, equal or 0.0, arguments.comparisons),
        target=arguments.power,
        most=arguments.most,
        simulations=arguments.simulations,
        seed=arguments.seed,
    )
    print(json.dumps(result, indent=1) if arguments.json else sample_size.as_text(result))
