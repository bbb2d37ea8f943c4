"""The `ha2g study` commands: arguments only; each calls one function of the package."""

import argparse
import pathlib
from typing import Any

from ha2g_jax.cli.parser import add_reading, positive, read_seed, reading
from ha2g_jax.errors import UserError

_PARTS = ("rating", "preference", "mismatch")


def add_commands(commands: Any) -> None:
    """Add `study` and its subcommands to the commands of a parser."""
    study = commands.add_parser("study", help="ask people about motion: make a study, analyse its answers")
    study.description = "Studies in which people watch motion in a browser and judge it; see docs/user_study.md."
    parts = study.add_subparsers(title="commands", required=True, metavar="COMMAND")
    _add_make(parts)
    _add_analyse(parts)
    _add_power(parts)


def _add_make(commands: Any) -> None:
    make = commands.add_parser("make", help="write the site of a study, and the key that says what it shows")
    make.description = (
        "Write a folder with site/, which any static host can serve, and key.json, which is not published: it says "
        "which video is which system."
    )
    make.add_argument(
        "motions", nargs="+", metavar="MOTIONS", help="folder of motion of each system, as DIR or NAME=DIR"
    )
    make.add_argument(
        "-o", "--out", type=pathlib.Path, default=pathlib.Path("study"), help="folder to write (default: study)"
    )
    make.add_argument(
        "--speech", type=pathlib.Path, metavar="DIR", help="folder of the sounds (default: beside the motion)"
    )
    make.add_argument(
        "--protocol",
        nargs="+",
        choices=_PARTS,
        default=[_PARTS[0]],
        help="rating: naturalness, smoothness and synchrony from 1 to 5; preference: two systems on one clip; "
        "mismatch: motion with its own or with other speech (default: rating)",
    )
    make.add_argument("--clips", type=positive, metavar="N", help="number of clips, drawn at random (default: all)")
    make.add_argument("--clip-seconds", type=float, metavar="S", help="length to which longer clips are cut")
    make.add_argument(
        "--per-participant",
        type=positive,
        default=24,
        metavar="N",
        help="maximum number of items of each part for a participant (default: 24)",
    )
    make.add_argument(
        "--attention", type=int, default=2, metavar="N", help="attention checks of each participant (default: 2)"
    )
    texts = make.add_argument_group("pages")
    texts.add_argument("--title", help="title that participants see")
    texts.add_argument(
        "--consent", type=pathlib.Path, metavar="FILE", help="text that participants agree to (default: a short one)"
    )
    texts.add_argument(
        "--closing", type=pathlib.Path, metavar="FILE", help="text at the end, such as a completion code"
    )
    texts.add_argument(
        "--post", metavar="URL", help="https:// address that answers are sent to (default: participants save a file)"
    )
    texts.add_argument("--size", type=positive, default=480, metavar="PIXELS", help="side of the videos (default: 480)")
    add_reading(make.add_argument_group("reading"))
    make.add_argument(
        "--seed", type=read_seed, help="seed of all choices; keep it private (default: drawn, and noted in key.json)"
    )
    make.set_defaults(run=_make)


def _make(arguments: argparse.Namespace) -> None:
    from ha2g_jax.apps.user_study.make import make_study

    names = ("speech", "protocol", "clips", "clip_seconds", "per_participant", "attention", "consent", "closing")
    names += ("post", "size", "seed")
    options = {name: getattr(arguments, name) for name in names} | reading(arguments)
    if arguments.title is not None:
        options["title"] = arguments.title
    print(make_study(arguments.motions, arguments.out, **options))


def _add_analyse(commands: Any) -> None:
    command = commands.add_parser("analyse", help="check answers, and compute scores, preferences and agreement")
    command.description = (
        "Check the answers of participants, leave out those that cannot be used, with the reason, and compute mean "
        "opinion scores, preferences, strengths, the share of matched motion and agreement, with intervals. See "
        "docs/user_study.md. The exit code is 1 if no participant is left."
    )
    command.add_argument(
        "answers", type=pathlib.Path, nargs="+", metavar="ANSWERS", help="answer files, or folders of them"
    )
    command.add_argument("--study", type=pathlib.Path, required=True, metavar="DIR", help="folder of ha2g study make")
    command.add_argument(
        "-o",
        "--out",
        type=pathlib.Path,
        metavar="DIR",
        help="folder for report.html, report.md and report.json (default: print the report as Markdown)",
    )
    command.set_defaults(run=_analyse)


def _analyse(arguments: argparse.Namespace) -> int:
    from ha2g_jax.apps.user_study import analysis, study_report

    results = analysis.analyse(arguments.answers, arguments.study)
    print(study_report.write_report(results, arguments.out) if arguments.out else study_report.as_markdown(results))
    return 0 if results["participants"] else 1


def _add_power(commands: Any) -> None:
    command = commands.add_parser("power", help="compute how many participants a study needs")
    command.description = (
        "Simulate studies and analyse them as ha2g study analyse does, to find the number of participants that shows "
        "an effect. Standard deviations are given, or those of a pilot study. See docs/user_study.md."
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
    search.add_argument(
        "--most", type=positive, default=500, metavar="N", help="largest number of participants to try (default: 500)"
    )
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
    from ha2g_jax.apps.user_study import power
    from ha2g_jax.apps.user_study.design import read_key
    from ha2g_jax.apps.user_study.power import Plan, Spreads

    given = [arguments.sd_participants, arguments.sd_clips, arguments.sd_rest if is_mos else 0.0]
    equal = arguments.equal
    if arguments.pilot is not None:
        found, share_of_equal = power.read_pilot(arguments.measure, arguments.pilot, read_key(arguments.study))
        given = [found[at] if value is None else value for at, value in enumerate(given)]
        equal = share_of_equal if equal is None else equal
    if None in given:
        names = "--sd-participants, --sd-clips and --sd-rest" if is_mos else "--sd-participants and --sd-clips"
        raise UserError(f"give {names}, or the answers of a pilot study: --pilot ANSWERS --study DIR")
    table = power.power_table(
        arguments.measure,
        arguments.difference if is_mos else arguments.share,
        Spreads(*given),
        Plan(arguments.clips, arguments.items or arguments.clips, equal or 0.0, arguments.comparisons),
        power=arguments.power,
        most=arguments.most,
    )
    print(table)
