"""The ``avrare`` command: finds the subcommand, imports only that one, and turns errors into exit codes."""

from __future__ import annotations

import argparse
import importlib
import io
import os
import sys
from collections.abc import Sequence
from importlib.metadata import entry_points
from typing import Any

import avrare
from avrare.cli.parser import Parser, command_parser
from avrare.errors import AvrareError, ExitCode, PluginError, UsageError, did_you_mean

COMMANDS = {
    "run": ("avrare.cli.run", "estimate the failure probabilities of scenarios"),
    "check": ("avrare.cli.check", "turn thresholds and baselines into an exit code"),
    "compare": ("avrare.cli.compare", "estimators side by side, with the same budget"),
    "validate": ("avrare.cli.validate", "check scenario files without running them"),
    "replay": ("avrare.cli.replay", "drive a stored failure again, shrink it, write it as a file"),
    "falsify": ("avrare.cli.falsify", "find a failure, then the most likely one"),
    "failures": ("avrare.cli.failures", "list stored failures, hand them on, sort them into kinds"),
    "rules": ("avrare.cli.rules", "list the traffic rules that plugins offer"),
    "monitor": ("avrare.cli.monitor", "score a recorded drive or a run's failure under a rule"),
    "report": ("avrare.cli.report", "a run's folder as one HTML file"),
    "history": ("avrare.cli.history", "estimates over commits"),
    "plugins": ("avrare.cli.plugins", "list the installed components"),
    "schema": ("avrare.cli.schema", "print the JSON schema of scenario files"),
    "new": ("avrare.cli.new", "make a plugin package to begin with"),
    "check-plugin": ("avrare.cli.check_plugin", "does a plugin keep to what avrare relies on?"),
}
"""Name -> module with ``add_arguments(parser)`` and ``execute(args) -> int``, and what it does."""

COMMAND_GROUP = "avrare.commands"

PROVIDED = {
    "pem": ("avrare-gp-pem", "fit a perception error model to detections"),
    "flow": ("avrare-flows", "fit a normalizing flow to samples of noise"),
    "synthesize": ("avrare-linear", "make a linear system's failure less likely"),
}
"""Name -> the distribution whose entry point of that name (group ``avrare.commands``) is such a module."""

_BROKEN_PIPE = 141
"""128 + SIGPIPE: what the shell reports of a program whose reader went away."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: The arguments after the program's name; those of the process by default.

    Returns:
        The exit code (``avrare.errors.ExitCode``).
    """
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        _tolerate_any_text()
        code = _dispatch(words)
        sys.stdout.flush()
        return code
    except AvrareError as error:
        print("\n".join(error.lines()), file=sys.stderr)
        return int(error.exit_code)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return int(ExitCode.INTERRUPTED)
    except BrokenPipeError:
        # Python flushes stdout once more at exit; give it somewhere to go.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _BROKEN_PIPE
    except SystemExit as finished:  # argparse after --help
        return finished.code if isinstance(finished.code, int) else int(ExitCode.PASS)
    except Exception as error:
        _report_bug(error, "--traceback" in words or os.environ.get("AVRARE_TRACEBACK") == "1")
        return int(ExitCode.BUG)


def _dispatch(words: list[str]) -> int:
    place = next((i for i, word in enumerate(words) if not word.startswith("-")), len(words))
    parser = _top_parser()
    parser.parse_args(words[:place])
    if place == len(words):
        parser.print_help()
        return int(ExitCode.PASS)
    name = words[place]
    module, summary = _command(name)
    command = command_parser(name, summary)
    module.add_arguments(command)
    return int(module.execute(command.parse_args(words[place + 1 :])))


def _command(name: str) -> tuple[Any, str]:
    """The module of a command, of the core or of a plugin, and what it does."""
    if name in COMMANDS:
        reference, summary = COMMANDS[name]
        return importlib.import_module(reference), summary
    if name not in PROVIDED:
        raise UsageError(f"avrare: unknown command {name!r}", did_you_mean(name, [*COMMANDS, *PROVIDED]))
    distribution, summary = PROVIDED[name]
    points = entry_points(group=COMMAND_GROUP, name=name)
    if not points:
        reason = f"avrare {name} is provided by {distribution}, which is not installed"
        raise PluginError(reason, f"pip install {distribution}")
    return next(iter(points)).load(), summary


def _top_parser() -> Parser:
    listing = "\n".join(f"  {name:<14}{summary}" for name, (_, summary) in (COMMANDS | PROVIDED).items())
    parser = Parser(
        prog="avrare",
        usage="avrare [-h] [--version] [--traceback] COMMAND ...",
        description=(avrare.__doc__ or "").partition("\n")[0],
        epilog=f"commands:\n{listing}\n\n'avrare COMMAND --help' says more.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"avrare {avrare.__version__}")
    parser.add_argument("--traceback", action="store_true", help="show the traceback of a bug")
    return parser


def _tolerate_any_text() -> None:
    """Paths may hold bytes, and terminals encodings, that cannot be printed as they are."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _report_bug(error: Exception, full: bool) -> None:
    import traceback

    if full:
        traceback.print_exc()
    words = " ".join(str(error).split())
    frame = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{frame.filename}:{frame.lineno} in {frame.name}"
    print(f"this is a bug in avrare: {type(error).__name__}: {words} ({place})", file=sys.stderr)
    if not full:
        print("hint: run it again with --traceback and report what it prints", file=sys.stderr)
