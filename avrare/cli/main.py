"""The ``avrare`` command: dispatch to one command's module, and exit codes for errors."""

from __future__ import annotations

import argparse
import importlib
import io
import os
import re
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, NoReturn, TextIO

from avrare.base import version
from avrare.base.errors import (
    AvrareError,
    ExitCode,
    OutOfMemory,
    PluginError,
    UsageError,
    did_you_mean,
    find_place,
)
from avrare.base.visible_text import spell_controls

COMMANDS = {
    "run": ("avrare.cli.run", "estimate the failure probabilities of scenarios"),
    "check": ("avrare.cli.check", "check thresholds and baselines: the CI gate"),
    "rate": ("avrare.cli.rate", "estimate rates per hour and km over a catalogue of scenes"),
    "compare": ("avrare.cli.compare", "compare estimators with equal budgets, or two versions of a scenario"),
    "validate": ("avrare.cli.validate", "check scenario files without running them"),
    "replay": ("avrare.cli.replay", "replay a stored failure, shrink it, export it"),
    "falsify": ("avrare.cli.falsify", "search for a failure, then for the most likely one"),
    "failures": ("avrare.cli.failures", "list, add and print stored failures"),
    "why": ("avrare.cli.why", "find the kinds of a run's failures, and the noise that carries them"),
    "rules": ("avrare.cli.rules", "list the traffic rules that plugins offer"),
    "report": ("avrare.cli.report", "write a run folder as one HTML file"),
    "plugins": ("avrare.cli.plugins", "list the installed components, or check those of a plugin"),
    "new": ("avrare.cli.new", "create a scenario, or a plugin package"),
}
"""Name -> module with ``execute(args)`` (returns the exit code, None: 0), and a summary."""

PROVIDED = {
    "monitor": ("avrare-recordings", "evaluate a rule or formula on a recorded drive or a failure"),
    "evidence": ("avrare-evidence", "write results as a safety case, or check one"),
    "confirm": ("avrare-evidence", "estimate a safety case's numbers again with another seed"),
    "sensitivity": ("avrare-design", "estimate how the probability changes with parameters"),
    "require": ("avrare-design", "find the parameter value that keeps a probability below a bound"),
    "synthesise": ("avrare-design", "change numbers of a scenario until its failures are rarer"),
    "pem": ("avrare-pem-training", "fit a perception error model to detections"),
    "flow": ("avrare-flows", "fit a normalising flow to samples of noise"),
    "scenes": ("avrare-openscenario", "check which OpenSCENARIO files can be read, or act one out"),
    "policy": ("avrare-policy", "convert a trained network to a policy file"),
}
"""Name -> distribution that provides the module (entry point of group ``avrare.commands``), and a summary.

The module has ``add_arguments(parser)`` as well.
"""

GROUPS = {
    "estimate": ("run", "rate", "compare"),
    "judge": ("check", "monitor", "rules", "evidence", "confirm"),
    "explain": ("why", "replay", "falsify", "failures", "sensitivity"),
    "look": ("report", "plugins", "scenes"),
    "build": ("new", "validate", "require", "synthesise", "pem", "flow", "policy"),
}
"""Heading in the help -> commands."""


class Parser(argparse.ArgumentParser):
    """Parser that raises ``UsageError`` instead of printing and exiting."""

    def error(self, message: str) -> NoReturn:
        """Raise the message that argparse would print; the hint is the most similar option, or --help."""
        message = re.sub(r"^argument (--[\w-]+): must", r"\1 must", message)
        unknown = re.match(r"unrecognized arguments: --([\w-]+)", message)
        options = [option.removeprefix("--") for option in self._option_string_actions]
        similar = did_you_mean(unknown[1], options) if unknown else None
        hint = f"see {self.prog} --help"
        if similar and similar.startswith("did"):
            hint = similar.replace("'", "'--", 1)
        raise UsageError(f"{self.prog}: {message}", hint)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line, by default that of the process, and return the exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        with _sigterm_like_ctrl_c():
            _prepare_streams()
            code = _dispatch(words)
            sys.stdout.flush()
            return code
    except AvrareError as error:
        _print_error(*error.lines())
        return int(error.exit_code)
    except MemoryError:
        _print_error(*OutOfMemory().lines())
        return int(ExitCode.INTERRUPTED)
    except KeyboardInterrupt:
        _print_error("interrupted")
        return int(ExitCode.INTERRUPTED)
    except BrokenPipeError:
        _drop_output(sys.stdout)
        return 141  # exit code after SIGPIPE, as shells report it: 128 + 13
    except SystemExit as finished:  # argparse after --help
        return finished.code if isinstance(finished.code, int) else int(ExitCode.PASS)
    except Exception as error:
        full = "--traceback" in words or os.environ.get("AVRARE_TRACEBACK") == "1"
        if isinstance(error, OSError) and not full:
            _print_error(*_system_error(error).lines())
            _drop_output(sys.stdout)
            return int(ExitCode.USAGE)
        _report_bug(error, full)
        return int(ExitCode.BUG)


@contextmanager
def _sigterm_like_ctrl_c() -> Iterator[None]:
    # From the first moment on, before ``Stopping`` takes over: it ends in words, without torn files.
    main_thread = threading.current_thread() is threading.main_thread()
    if not main_thread or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _dispatch(words: list[str]) -> int:
    place = next((i for i, word in enumerate(words) if not word.startswith("-")), len(words))
    parser = _top_parser()
    parser.parse_args(words[:place])
    if place == len(words):
        parser.print_help()
        return int(ExitCode.PASS)
    name = words[place]
    args = command_parser(name).parse_args(words[place + 1 :])
    if args.out == "":
        raise UsageError("--out is empty", "name a folder, or leave --out out; is a shell variable unset?")
    if not args.safe:
        return _execute(name, args)
    from avrare.scenario.safe_mode import safe_mode

    with safe_mode():
        return _execute(name, args)


def _execute(name: str, args: argparse.Namespace) -> int:
    try:
        return int(_module(name).execute(args) or ExitCode.PASS)
    except SystemExit as end:  # or else a part that calls exit(0) would let a gate pass
        reason = f"a part of the stack ends the program, by exit({'' if end.code is None else end.code})"
        raise PluginError(reason, "raise an error there instead") from end


def command_parser(name: str) -> Parser:
    """Return the parser of a command."""
    commands = COMMANDS | PROVIDED
    if name not in commands:
        hint = did_you_mean(name, commands) or "'avrare --help' lists the commands"
        raise UsageError(f"avrare: unknown command {name!r}", hint)
    parser = Parser(prog=f"avrare {name}", description=commands[name][1], allow_abbrev=False)
    parser.add_argument("--traceback", action="store_true", help="print the traceback of an internal error")
    parser.set_defaults(out=None, safe=False)
    from avrare.cli import options

    if name in options.OPTIONS:
        options.add_options(parser, name)
    else:
        _module(name).add_arguments(parser)
    return parser


def _module(name: str) -> Any:
    if name in COMMANDS:
        return importlib.import_module(COMMANDS[name][0])
    from avrare.plugin.provided import load_command

    return load_command(name, PROVIDED[name][0])


def _top_parser() -> Parser:
    commands = COMMANDS | PROVIDED
    listing = "\n\n".join(
        "\n".join([f"{title}:", *(f"  {name:<14}{commands[name][1]}" for name in names)])
        for title, names in GROUPS.items()
    )
    parser = Parser(
        prog="avrare",
        usage="avrare [-h] [--version] [--traceback] COMMAND ...",
        description="avrare: how likely is this driving stack to break this traffic rule?",
        epilog=f"{listing}\n\n'avrare COMMAND --help' shows the options of a command.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"avrare {version.__version__}")
    parser.add_argument("--traceback", action="store_true", help="print the traceback of an internal error")
    parser.set_defaults(out=None, safe=False)
    return parser


def _prepare_streams() -> None:
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the caller
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    if os.environ.get("COLUMNS") == "0":  # some build servers; unknown, but nothing would be printed
        del os.environ["COLUMNS"]
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _print_error(*lines: str) -> None:
    try:
        print("\n".join(lines), file=sys.stderr, flush=True)
    except OSError:  # a standard error that takes nothing
        _drop_output(sys.stderr)


def _drop_output(stream: TextIO) -> None:
    # Python flushes the stream once more at exit; give it somewhere to go.
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _system_error(error: OSError) -> UsageError:
    # What no command explains: a path too long, a loop of links, a disk that is full or fails.
    name = f"{error.filename[:200]}: " if isinstance(error.filename, str) else ""
    hint = "check this path" if name else "check the disk, the current folder, and where the output goes"
    return UsageError(f"{name}{error.strerror or error}", hint)


def _report_bug(error: Exception, full: bool) -> None:
    if full:
        import traceback

        _print_error(traceback.format_exc())
    words = " ".join(str(error).split())
    line = f"this is a bug in avrare: {type(error).__name__}: {words} ({find_place(error)})"
    hint = [] if full else ["hint: run the command again with --traceback and report the output"]
    _print_error(spell_controls(line), *hint)
