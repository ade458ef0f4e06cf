"""Argument parser of the command line, and the options that several commands share."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NoReturn

from avrare.base.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    from avrare.report.terminal.console import Mode
    from avrare.scenario.schema import Scenario


class Parser(argparse.ArgumentParser):
    """Parser that raises ``UsageError`` instead of printing and exiting."""

    def error(self, message: str) -> NoReturn:
        """Raise what argparse would print; the hint is the most similar option, or the usage."""
        message = re.sub(r"^argument (--[\w-]+): must", r"\1 must", message)
        unknown = re.match(r"unrecognized arguments: (--[\w-]+)", message)
        similar = did_you_mean(unknown[1], self._option_string_actions) if unknown else None
        usage = " ".join(self.format_usage().split())
        hint = similar if similar and similar.startswith("did") else usage
        raise UsageError(f"{self.prog}: {message}", hint)


def command_parser(name: str, summary: str) -> Parser:
    """Return the parser of one command, with the options that all commands share."""
    parser = Parser(prog=f"avrare {name}", description=summary, allow_abbrev=False)
    parser.add_argument("--traceback", action="store_true", help="print the traceback of an internal error")
    return parser


def set_epilog(parser: argparse.ArgumentParser, text: str) -> None:
    """Print ``text`` as it stands after the list of options."""
    parser.epilog = text
    parser.formatter_class = argparse.RawDescriptionHelpFormatter


def at_least(minimum: int) -> Callable[[str], int]:
    """Return an argparse type for integers of at least ``minimum``."""

    def integer(text: str) -> int:
        try:
            number = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"must be a whole number, not {text!r}") from None
        if number < minimum:
            raise argparse.ArgumentTypeError(f"must be at least {minimum}, not {text}")
        return number

    return integer


def add_scenario_arguments(parser: argparse.ArgumentParser, *, optional: bool = False) -> None:
    """Add ``SCENARIO... --set KEY=VALUE --estimator NAME``; at least one scenario unless ``optional``."""
    parser.add_argument("scenarios", nargs="*" if optional else "+", metavar="SCENARIO", help="scenario file")
    add_set_argument(parser, "override one value, e.g. estimator.rollouts=1000; may be repeated")
    parser.add_argument(
        "--estimator",
        metavar="NAME",
        help="use estimator NAME with its defaults instead of the scenario's estimator block",
    )


def add_set_argument(parser: argparse._ActionsContainer, text: str = "override one value") -> None:
    """Add ``--set KEY=VALUE``, which may be repeated."""
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=text)


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``--seed --workers --executor --budget``, for commands that run estimates."""
    parser.add_argument("--seed", type=int, metavar="N", help="random seed; default: the scenario's")
    add_workers_argument(parser)
    parser.add_argument(
        "--executor",
        metavar="NAME",
        help="executor: serial, processes or ray (with options: ray,address=auto); default: processes if "
        "workers > 1, else serial",
    )
    parser.add_argument(
        "--budget", metavar="KIND=N", help="budget per estimate: steps=N, rollouts=N or seconds=N"
    )


def add_workers_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--workers N``."""
    parser.add_argument("--workers", type=at_least(1), default=1, metavar="N", help="processes (default 1)")


def add_display_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``--quiet`` and ``--plain``, read by ``display``."""
    shown = parser.add_mutually_exclusive_group()
    shown.add_argument("--quiet", action="store_true", help="print only verdicts and errors")
    shown.add_argument("--plain", action="store_true", help="no colours, nothing redrawn: for logs")


def overrides(args: argparse.Namespace) -> list[str]:
    """Return the settings of ``--set`` and ``--seed``."""
    return [*args.set, *([f"seed={args.seed}"] if args.seed is not None else [])]


def load_scenarios(args: argparse.Namespace, settings: Sequence[str]) -> list[Scenario]:
    """Load the scenarios on the command line.

    Raises:
        UsageError: Two scenarios have the same name.
    """
    from avrare.scenario.load import load

    scenarios = [load(path, settings, args.estimator) for path in args.scenarios]
    names = sorted(scenario.name for scenario in scenarios)
    if len(set(names)) < len(names):
        raise UsageError(f"two scenarios have the same name: {', '.join(names)}", "give one per command")
    return scenarios


def display(args: argparse.Namespace) -> Mode:
    """Return the display mode that ``--quiet`` and ``--plain`` select."""
    return "quiet" if args.quiet else "plain" if args.plain else "auto"
