"""Errors that a user can act on, and the exit codes of the command line.

Every error carries a hint (what to do next) and the exit code of the command. Any other exception is a bug of
avrare and exits with ``ExitCode.BUG``.
"""

from __future__ import annotations

import difflib
import os
import re
import traceback
from collections.abc import Iterable
from enum import IntEnum

from avrare.base.visible_text import spell_controls


class ExitCode(IntEnum):
    """Exit codes of the command line."""

    PASS = 0
    """The run finished; for ``check``: every threshold holds."""
    FAIL = 1
    """A threshold or a regression failed."""
    INTERRUPTED = 2
    """Stopped by the user; the checkpoint is kept."""
    INCONCLUSIVE = 3
    """The interval contains a threshold."""
    USAGE = 4
    """The scenario or the command is wrong."""
    PLUGIN = 5
    """A plugin is missing, broken or incompatible."""
    ROLLOUT_ERRORS = 6
    """More rollouts ended in an error than the scenario allows, or the system ended its process."""
    BUG = 70
    """A bug of avrare itself."""


class AvrareError(Exception):
    """Base class of all errors that are shown without a traceback.

    Args:
        message: The mistake and its place.
        hint: Advice for the next step, or None.
    """

    exit_code = ExitCode.USAGE

    def __init__(self, message: str, hint: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.message, self.hint)

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def lines(self) -> list[str]:
        """Return the lines to print on stderr, with control characters spelt out."""
        return [*map(spell_controls, [self.message] + ([f"hint: {self.hint}"] if self.hint else []))]


class HealthWarning(UserWarning):
    """Reason to doubt an estimate: a health warning of a ``Result`` that ``avrare.estimate`` returns."""


class UsageError(AvrareError):
    """A wrong argument, option or call."""


class ScenarioError(AvrareError):
    """An invalid scenario file: one or more problems, each with its position.

    Args:
        problems: (message, hint) pairs; the message starts with ``file:line:column: path:``.
        exit_code: ``ExitCode.PLUGIN`` where missing plugins are the only problem.
    """

    def __init__(self, problems: list[tuple[str, str | None]], exit_code: ExitCode = ExitCode.USAGE) -> None:
        super().__init__("\n".join(message for message, _ in problems))
        self.problems = problems
        self.exit_code = exit_code

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.problems, self.exit_code)

    def lines(self) -> list[str]:
        """Return every problem, each followed by its hint; missing packages share one."""
        install = "pip install "
        missing = [(text, hint) for text, hint in self.problems if hint and hint.startswith(install)]
        lines = [
            line
            for problem in self.problems
            if problem not in missing
            for line in AvrareError(*problem).lines()
        ]
        packages = dict.fromkeys(word for _, hint in missing for word in hint.removeprefix(install).split())
        hint = install + " ".join(packages) if packages else None
        return lines + (AvrareError("\n".join(_join_places(missing)), hint).lines() if missing else [])


class FormulaError(UsageError):
    """A formula that cannot be parsed or does not fit the signals."""


class Interrupted(AvrareError):
    """An estimate that was interrupted; its saved chunks are kept."""

    exit_code = ExitCode.INTERRUPTED


class OutOfMemory(AvrareError):
    """An end for want of memory that could not be foretold; saved chunks are kept."""

    exit_code = ExitCode.INTERRUPTED

    def __init__(self, message: str = "out of memory", hint: str | None = None) -> None:
        advice = "use fewer workers, a smaller chunk, fewer particles, or the estimator's option memory"
        super().__init__(message, hint or advice)


FIRST_ROLLOUTS = 200
"""Rollouts of an estimate that all end in an error, after which it ends."""


class EveryRolloutBroke(AvrareError):
    """An end because the first rollouts of an estimate all ended in an error."""

    exit_code = ExitCode.ROLLOUT_ERRORS

    def __init__(self, message: str, hint: str | None = None) -> None:
        advice = "`avrare validate --build` runs the first steps, and names the part that breaks down"
        super().__init__(message, hint or advice)

    @staticmethod
    def after(cause: str) -> EveryRolloutBroke:
        """Return the error with the cause of the first of them."""
        return EveryRolloutBroke(f"each of the first {FIRST_ROLLOUTS} rollouts ended in an error: {cause}")


class PluginError(AvrareError):
    """A plugin that is missing, broken, or lacks a dependency."""

    exit_code = ExitCode.PLUGIN


def require_path(value: object, wanted: str, hint: str | None = None) -> str:
    """Return a path as text.

    Args:
        value: The path.
        wanted: Noun for the object at the path, such as "a scenario file".
        hint: Advice where it is not a path; None: to give one.

    Raises:
        UsageError: The value is not a path.
    """
    path = os.fspath(value) if isinstance(value, (str, os.PathLike)) else None
    if not isinstance(path, str):
        raise UsageError(f"{wanted} is needed, not {type(value).__name__}", hint or "give its path")
    return path


_INSTALL = "pip install "


def _join_places(problems: Iterable[tuple[str, str]]) -> list[str]:
    """Return each message once, with the other lines of the file at which it applies."""
    lines: dict[tuple[str, str], list[str]] = {}
    first: dict[tuple[str, str], str] = {}
    for message, _ in problems:
        place = re.match(r"(.*?):(\d+):\d+: [^:]*: (.*)", message)
        file, line, text = place.groups() if place else ("", "", message)
        first.setdefault((file, text), message)
        lines.setdefault((file, text), []).append(line)
    return [
        message + (f" (also in line {', '.join(lines[key][1:])})" if len(lines[key]) > 1 else "")
        for key, message in first.items()
    ]


def did_you_mean(word: str, candidates: Iterable[str]) -> str | None:
    """Return a hint with the closest candidate, or with all of them if there are few, or None."""
    names = sorted(set(candidates))
    close = difflib.get_close_matches(word, names, n=1, cutoff=0.6)
    if close:
        return f"did you mean {close[0]!r}?"
    if names and len(names) <= 16:
        return "known: " + ", ".join(names)
    return None


def find_place(error: BaseException) -> str:
    """Return ``file:line in function`` of the last frame; of a file that cannot be read, file and line."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}:{error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    if not frames:
        return "unknown place"
    return f"{frames[-1].filename}:{frames[-1].lineno} in {frames[-1].name}"
