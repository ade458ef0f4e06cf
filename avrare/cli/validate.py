"""``avrare validate``: check scenario files; static unless ``--build`` is given."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

from avrare.analysis.rates.catalogue import is_catalogue, load_catalogue
from avrare.base.error_place import find_place
from avrare.base.errors import AvrareError, ExitCode, PluginError, UsageError
from avrare.cli.output import print_warnings, say
from avrare.scenario.load import load
from avrare.scenario.schema import Scenario

_PURPOSE = "the first steps of the stack"


def execute(args: argparse.Namespace) -> int:
    """Check every scenario and print a line for each; return the smallest non-zero exit code."""
    codes = [_check(path, args) for path in args.scenarios]
    failed = [code for code in codes if code != ExitCode.PASS]
    return min(failed, default=int(ExitCode.PASS))


def _build(scenario: Scenario) -> list[str]:
    """Build the stack, run a few steps and return what there is to say of draws and memory."""
    from avrare.estimation.estimate_problem import check_scenario  # builds no part unless it is asked to
    from avrare.rollout.child_process import run_guarded
    from avrare.rollout.loaded_scenario import LoadedScenario
    from avrare.stack.builder import try_draws, try_stack

    built = LoadedScenario(scenario)
    stack = built.stack
    with first_steps(scenario):
        print_warnings(run_guarded(_PURPOSE, stack.loop, partial(try_stack, scenario, stack, steps=3)))
    found, memory = check_scenario(built)
    print_warnings((f"{scenario.path}: {name}: {text}", None) for name, text in found.items())
    with first_steps(scenario):
        draws = run_guarded(_PURPOSE, stack.loop, partial(try_draws, scenario, stack))
    return [*draws, memory.describe()]


@contextmanager
def first_steps(scenario: Scenario) -> Iterator[None]:
    """Tell what a part of the stack raises as its own mistake; in a run such rollouts count as errors."""
    try:
        yield
    except (AvrareError, MemoryError):
        raise
    except (Exception, SystemExit) as error:
        text = f"{scenario.path}: the stack breaks down in its first steps: {type(error).__name__}: {error}"
        raise PluginError(f"{text} ({find_place(error)})") from error


def _refuse_options(path: str, args: argparse.Namespace) -> None:
    for option, given in (("--set", args.set), ("--estimator", args.estimator), ("--build", args.build)):
        if given:
            text = f"{option} is an option of scenarios, and {path} is a catalogue"
            raise UsageError(text, f"leave it out, or give the catalogue's scenarios with {option}")


def _check(path: str, args: argparse.Namespace) -> int:
    try:
        if is_catalogue(path):
            _refuse_options(path, args)
            catalogue = load_catalogue(path)
            scenes, rules = len(catalogue.document.scenes), len(catalogue.rules)
            say(f"{path}: ok  {catalogue.document.name}, a catalogue of {scenes} scenes and {rules} rules")
            return int(ExitCode.PASS)
        scenario = load(path, args.set, args.estimator)
        print_warnings(scenario.warnings)
        found = _build(scenario) if args.build else []
    except AvrareError as error:
        say("\n".join(error.lines()), error=True)
        return int(error.exit_code)
    steps, count = scenario.steps, len(scenario.specifications)
    parts = [
        scenario.name,
        f"{steps} step{'s' * (steps != 1)}",
        f"{count} specification{'s' * (count != 1)}",
        f"estimator {scenario.estimator.plugin}",
        *(["built and run for 3 steps"] if args.build else []),
    ]
    say(f"{path}: ok  {', '.join(parts)}")
    for line in found:
        say(f"  {line}")
    return int(ExitCode.PASS)
