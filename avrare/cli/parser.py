"""Argparse in the house style: its errors are ours, with a hint and exit code 4."""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING, NoReturn

from avrare.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    from avrare.report.progress import Mode


class Parser(argparse.ArgumentParser):
    """A parser that raises ``UsageError`` instead of printing and exiting."""

    def error(self, message: str) -> NoReturn:
        """Raise what argparse would print, with the nearest option or the usage as hint."""
        unknown = re.match(r"unrecognized arguments: (--[\w-]+)", message)
        near = did_you_mean(unknown[1], self._option_string_actions) if unknown else None
        usage = " ".join(self.format_usage().split())
        raise UsageError(f"{self.prog}: {message}", near if near and near.startswith("did") else usage)


def command_parser(name: str, summary: str) -> Parser:
    """The parser of one subcommand, with the options that all of them share."""
    parser = Parser(prog=f"avrare {name}", description=summary, allow_abbrev=False)
    parser.add_argument("--traceback", action="store_true", help="show the traceback of a bug")
    return parser


def add_scenario_arguments(parser: argparse.ArgumentParser, *, optional: bool = False) -> None:
    """``SCENARIO... --set KEY=VALUE --estimator NAME``, for every command that loads scenarios.

    They arrive as ``args.scenarios``, ``args.set`` and ``args.estimator``, ready for ``load``.

    Args:
        parser: That of the command.
        optional: Whether there may be no scenario.
    """
    many = "*" if optional else "+"
    parser.add_argument("scenarios", nargs=many, metavar="SCENARIO", help="scenario file")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override one value, e.g. estimator.rollouts=1000; may be repeated",
    )
    parser.add_argument("--estimator", metavar="NAME", help="replace the estimator block by NAME's defaults")


def add_display_arguments(parser: argparse.ArgumentParser) -> None:
    """``--quiet`` or ``--plain``, for every command that shows progress and a table; read by ``display``."""
    shown = parser.add_mutually_exclusive_group()
    shown.add_argument("--quiet", action="store_true", help="only the verdicts, and what went wrong")
    shown.add_argument("--plain", action="store_true", help="no colours, nothing redrawn: for logs")


def display(args: argparse.Namespace) -> Mode:
    """How much is shown, and how."""
    return "quiet" if args.quiet else "plain" if args.plain else "auto"
