"""Validation of a scenario file or a catalogue; the first steps of its stack are run where asked."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

from avrare.analysis.rates.catalogue import load_catalogue
from avrare.base.errors import (
    AvrareError,
    ExitCode,
    PluginError,
    ScenarioError,
    UsageError,
    find_place,
    require_path,
)
from avrare.base.number_format import format_count
from avrare.base.records import Answer, Records
from avrare.scenario.load import is_catalogue, load
from avrare.scenario.safe_mode import safe_mode
from avrare.scenario.schema import Scenario

_STEPS = 3
"""Steps of the stack that are run."""

Line = tuple[str, str | None]
"""A message and its hint."""


@dataclass(frozen=True, repr=False)
class Validation(Answer):
    """Outcome of a validation.

    Attributes:
        path: The file.
        contents: Name and sizes of the scenario or catalogue; empty where it is not valid.
        warnings: Messages, with hints, on valid input that may not be meant.
        error: What is wrong; None where the file is valid.
        notes: Lines on draws, memory and integration of the built stack.
    """

    path: str
    contents: tuple[str, ...]
    warnings: tuple[Line, ...] = ()
    error: AvrareError | None = None
    notes: tuple[str, ...] = ()

    @property
    def valid(self) -> bool:
        """True if nothing is wrong."""
        return self.error is None

    @property
    def mistakes(self) -> tuple[Line, ...]:
        """Mistakes with hints, with line and column where they are of the file."""
        if isinstance(self.error, ScenarioError):
            return tuple(self.error.problems)
        return () if self.error is None else ((self.error.message, self.error.hint),)

    @property
    def exit_code(self) -> ExitCode:
        """Exit code of the command."""
        return ExitCode.PASS if self.error is None else self.error.exit_code

    def table(self) -> Records:
        """Return one row for each mistake and each warning."""
        rows = [("mistake", *line) for line in self.mistakes] + [("warning", *line) for line in self.warnings]
        return Records({"sort": sort, "text": text, "hint": hint} for sort, text, hint in rows)

    def lines(self) -> list[str]:
        """Return the mistakes, or the content of the file."""
        if self.error is not None:
            return self.error.lines()
        return [f"{self.path}: ok  {', '.join(self.contents)}", *(f"  {note}" for note in self.notes)]

    def __repr__(self) -> str:
        warnings = [f"warning: {text}" + (f"\nhint: {hint}" if hint else "") for text, hint in self.warnings]
        return "\n".join([*warnings, *self.lines()])


def validate(
    path: str | os.PathLike[str],
    overrides: Sequence[str] = (),
    *,
    estimator: str | None = None,
    build: bool = False,
    safe: bool = False,
) -> Validation:
    """Check a scenario file or a catalogue without running it.

    Args:
        path: YAML file.
        overrides: Settings as for ``--set``.
        estimator: Name of another estimator, with its default options.
        build: Build the stack as well, run three steps, and a few tapes with half the integration step.
        safe: As for ``avrare.load``.

    Returns:
        The outcome, with all mistakes in the file.
    """
    name, warnings = require_path(path, "a scenario file"), list[Line]()
    try:
        with safe_mode(safe):
            if is_catalogue(name):
                _refuse_options(name, overrides, estimator, build)
                return Validation(name, _describe_catalogue(name))
            scenario = load(name, overrides, estimator)
            warnings += scenario.warnings
            notes = _try_stack(scenario, warnings) if build else []
    except AvrareError as error:
        return Validation(name, (), tuple(warnings), error)
    return Validation(name, _describe(scenario, build), tuple(warnings), notes=tuple(notes))


def _refuse_options(path: str, overrides: Sequence[str], estimator: str | None, build: bool) -> None:
    for option, value in (("a setting", overrides), ("an estimator", estimator), ("a build", build)):
        if value:
            text = f"{option} is for scenarios, and {path} is a catalogue"
            raise UsageError(text, "leave it out, or validate the catalogue's scenarios with it")


def _describe_catalogue(path: str) -> tuple[str, ...]:
    catalogue = load_catalogue(path)
    scenes = format_count(len(catalogue.document.scenes), "scene")
    return (
        catalogue.document.name,
        f"a catalogue of {scenes} and {format_count(len(catalogue.rules), 'rule')}",
    )


def _describe(scenario: Scenario, built: bool) -> tuple[str, ...]:
    steps, count = scenario.steps, len(scenario.specifications)
    return (
        scenario.name,
        f"{steps} step{'s' * (steps != 1)}",
        f"{count} specification{'s' * (count != 1)}",
        f"estimator {scenario.estimator.plugin}",
        *([f"built and run for {_STEPS} steps"] if built else []),
    )


def _try_stack(scenario: Scenario, warnings: list[Line]) -> list[str]:
    """Build the stack, run a few steps, add to the warnings, and return the messages."""
    from avrare.analysis.check.refinement import compare_substeps
    from avrare.estimation.estimate import check_scenario  # builds no part unless it is asked to
    from avrare.rollout.child_process import run_guarded
    from avrare.rollout.loaded_scenario import LoadedScenario
    from avrare.stack.trial import try_draws, try_stack

    built = LoadedScenario(scenario)
    stack = built.stack
    purpose = "the first steps of the stack"
    with first_steps(scenario):
        warnings += run_guarded(purpose, stack.loop, partial(try_stack, scenario, stack, steps=_STEPS))
    clearances = check_scenario(built)
    messages = {name: text for clearance in clearances for name, text in clearance.warnings.items()}
    warnings += [(f"{scenario.path}: {name}: {text}", None) for name, text in messages.items()]
    memory = max((clearance.memory for clearance in clearances), key=lambda forecast: forecast.total)
    with first_steps(scenario):
        draws = run_guarded(purpose, stack.loop, partial(try_draws, scenario, stack))
        changes = run_guarded(purpose, stack.loop, partial(compare_substeps, scenario, stack))
    return [*draws, memory.describe(), *changes]


@contextmanager
def first_steps(scenario: Scenario) -> Iterator[None]:
    """Raise an error of a part of the stack as its own mistake; in a run such rollouts count as errors."""
    try:
        yield
    except (AvrareError, MemoryError):
        raise
    except (Exception, SystemExit) as error:
        text = f"{scenario.path}: the stack breaks down in its first steps: {type(error).__name__}: {error}"
        raise PluginError(f"{text} ({find_place(error)})") from error
