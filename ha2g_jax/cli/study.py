"""The `ha2g study` commands: a user study of gestures; arguments only."""

from typing import Any

from ha2g_jax.cli import study_analysis


def add_command(commands: Any) -> None:
    """Add `study` and its subcommands to the commands of a parser."""
    parser = commands.add_parser("study", help="make and analyse a user study of gestures")
    parser.description = "Make and analyse a user study of gestures. See docs/user_study_analysis.md."
    study = parser.add_subparsers(required=True, metavar="COMMAND")
    study_analysis.add_commands(study)
