"""Specifications of a scenario at rarer levels, whose probabilities are known from its truth."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from avrare.protocols import Signals, Specification, Verdict
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.problem import Problem
from avrare.scenario.load import load
from benchmarks.studies import table2_page, truth

ROOT = Path(__file__).parents[2]


class Level(Specification):
    """Specification that a rule's robustness stays above a level.

    It has no formula, so that rollouts run to their end and are ordered by robustness.

    Args:
        rule: Specification of the rule.
        level: Robustness that is violated, with all below it.
    """

    def __init__(self, rule: Specification, level: float) -> None:
        self.rule = rule
        self.level = level

    def start(self, n: int) -> Any:
        """Return the rule's state before sample 0."""
        return self.rule.start(n)

    def update(self, state: Any, signals: Signals) -> tuple[Any, Verdict]:
        """Return the rule's state, and its verdict at the level."""
        state, verdict = self.rule.update(state, signals)
        robustness = verdict.robustness - self.level
        violated = verdict.robustness <= self.level
        return state, replace(verdict, robustness=robustness, violated=violated, score=-robustness)


def truth_file(scenario: str) -> Path:
    """Return the truth in ``docs/ground-truth`` of a scenario: a name in ``scenarios/``, or a path."""
    folder, loaded = ROOT / "docs" / "ground-truth", load(_path(scenario))
    return folder / f"{loaded.name}-{table2_page.ground_truth(folder, loaded)['fingerprint']}.json"


def _path(scenario: str) -> str:
    return scenario if scenario.endswith(".yaml") else str(ROOT / "scenarios" / f"{scenario}.yaml")


def read_case(name: str) -> tuple[Problem, float]:
    """Return the problem of SCENARIO:SPECIFICATION, with @P or =P behind, and its known probability.

    SCENARIO is a name in ``scenarios/`` or the path of a YAML file. With @P the level that a share P of the
    truth's rollouts falls to; =P says what the probability is where there is no truth.
    """
    scenario, _, rule = name.partition(":")
    if "=" in rule:
        rule, _, known = rule.partition("=")
        return LoadedScenario(load(_path(scenario))).problem(rule), float(known)
    rule, _, probability = rule.partition("@")
    return read_level(scenario, rule, float(probability) if probability else None)


def read_level(scenario: str, rule: str, probability: float | None) -> tuple[Problem, float]:
    """Return a rule at the level that it falls to with about this probability, and the known one.

    Args:
        scenario: Name of a file in ``scenarios/`` with a truth in ``docs/ground-truth``, or a path of one.
        rule: Name of a specification.
        probability: Probability of the level; None: the rule itself.
    """
    file = truth_file(scenario)
    found = json.loads(file.read_text(encoding="utf-8"))
    problem = LoadedScenario(load(_path(scenario))).problem(rule)
    if probability is None:
        counts = next(one for one in found["estimates"] if one["specification"] == rule)
        return problem, counts["probability"]
    tail = truth.read_tails(file)[rule]
    # Of the last value of a tail it is not known how many more rollouts share it.
    level = tail.threshold(min(probability, (len(tail.robustness) - 1) / tail.rollouts))
    known, _ = tail.probability(level)
    (monitor,) = problem.monitors
    return Problem(problem.system, Level(monitor, level), problem.steps, chunk=problem.named_chunk), known
