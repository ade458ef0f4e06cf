"""Paired comparison: two versions of a stack on the same noise.

Most rollouts have the same outcome under both versions, and only the others carry information about the
change, so far fewer rollouts distinguish the versions than two estimates with independent noise would need.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from avrare.analysis.compare.study import StudyWatch, parse_cost
from avrare.analysis.compare.version_changes import EstimatedChange, PairedCounts, VersionChange
from avrare.base.errors import FIRST_ROLLOUTS, EveryRolloutBroke, UsageError, require_path
from avrare.base.number_format import format_difference, format_signed_interval
from avrare.base.records import Answer, Records
from avrare.estimation.combine.specifications import Execution
from avrare.estimation.estimate import estimate_scenario
from avrare.estimation.loop.loop import Progress
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.plan import Info
from avrare.protocols import Floats
from avrare.rollout.executors.work import Executor, Work, build_executor
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request, Rollouts
from avrare.scenario.fingerprint import comparable
from avrare.scenario.load import load
from avrare.scenario.overrides import Setting, as_settings, read_driver
from avrare.scenario.safe_mode import safe_mode
from avrare.scenario.schema import Scenario
from avrare.stack.part_checks import find_noise_names

_VERSIONS = ("first", "second")

PairedWatch = Callable[[int], Callable[[Info], None]]
"""Called with 0 and 1 as the first and the second version begin; gives the progress display."""


@dataclass(frozen=True, repr=False)
class PairedComparison(Answer):
    """Result of a paired comparison.

    Attributes:
        names: The files, or the controller that takes the stack's place.
        scenarios: The resolved scenarios.
        changes: Change of each specification.
        rollouts: Rollouts of each version on the same noise; 0: an estimator chose its own.
        seed: Seed of the noise.
    """

    names: tuple[str, str]
    scenarios: tuple[Scenario, Scenario]
    changes: tuple[VersionChange, ...]
    rollouts: int
    seed: int

    @property
    def confidence(self) -> float:
        """Confidence of the intervals: the first scenario's."""
        return self.scenarios[0].confidence

    @property
    def has_too_many_errors(self) -> bool:
        """True if more rollouts ended in an error than the first scenario allows."""
        return any(change.exceeds(self.scenarios[0].max_error_rate) for change in self.changes)

    def headline(self) -> list[str]:
        """Return the names of both versions."""
        first, second = self.names
        if second == first:
            same = comparable(self.scenarios[0]) == comparable(self.scenarios[1])
            second = "itself" if same else f"{second} with other settings"
        how = f"{self.rollouts:,} rollouts each, on the same noise"
        return [f"{first} against {second}: {how if self.rollouts else self.scenarios[0].estimator.plugin}"]

    def summary(self) -> list[str]:
        """Return the change of each specification and its ratio in a line."""
        lines = []
        for change in self.changes:
            interval = format_signed_interval(change.interval(self.confidence))
            text = f"{change.specification}: {change.verdict(self.confidence)}"
            ratio = change.describe_ratio(self.confidence)
            if change.first or change.second:
                ratio = f"the first fails {ratio} times as often as the second"
            lines.append(f"{text}, {format_difference(change.difference)} ({interval}); {ratio}")
        return lines

    def notes(self) -> list[str]:
        """Return remarks for the reader of the table."""
        return [*self._note_other_changes(), *(line for change in self.changes for line in change.notes)]

    def _note_other_changes(self) -> list[str]:
        """Return which rules differ, and whether the simulators do: the change is not the stack's alone."""
        first, second = map(comparable, self.scenarios)
        rules = [change.specification for change in self.changes]
        changed = [name for name in rules if first["specifications"][name] != second["specifications"][name]]
        lines = [f"{', '.join(changed)}: the two versions judge by different rules"] if changed else []
        if first["simulator"] != second["simulator"]:
            lines.append("the two versions have different simulators")
        return [f"{line}: the change is not that of the stack alone" for line in lines]

    def table(self) -> Records:
        """Return one row for each specification."""
        rows = []
        for change in self.changes:
            low, high = change.interval(self.confidence)
            ratio_low, ratio_high = change.ratio_interval(self.confidence)
            rows.append(
                {
                    "specification": change.specification,
                    "first": change.first,
                    "second": change.second,
                    "change": change.difference,
                    "low": low,
                    "high": high,
                    "ratio": change.ratio,
                    "ratio_low": ratio_low,
                    "ratio_high": ratio_high,
                    **change.numbers,
                    "verdict": change.verdict(self.confidence),
                }
            )
        return Records(rows)

    def lines(self) -> list[str]:
        """Return both versions, the change of each specification, and the notes."""
        return [*self.headline(), *self.summary(), *self.notes()]


def compare_versions(
    first: str | os.PathLike[str],
    second: str | os.PathLike[str],
    specification: str | None = None,
    *,
    estimator: str | None = None,
    budget: Budget | Mapping[str, float] | str | None = None,
    overrides: Sequence[str] = (),
    seed: int | None = None,
    workers: int = 1,
    watch: StudyWatch | None = None,
    safe: bool = False,
) -> PairedComparison:
    """Run two versions of a scenario on the same noise, and tell how each probability changes.

    Args:
        first: Scenario file.
        second: The other version of it, or ``"CONTROLLER=MODEL"``: the same scenario, driven by a controller
            such as ``"reference_driver=fsm"`` in place of the stack's and its emergency braking.
        specification: Name; None: all that both estimate.
        estimator: Estimator of both versions where failures are rare, with options where wanted, such as
            ``"ams:particles=100"``; None: Monte Carlo on the same noise.
        budget: Budget of each version, in steps or rollouts; None: 1000 rollouts, or the estimator's own.
        overrides: Settings: ``"scenario.steps=20"`` for both, ``"against.steps=20"`` for the second only.
        seed: Seed of the noise; None: the first scenario's.
        workers: Number of processes; changes no number.
        watch: Progress display.
        safe: As for ``avrare.load``.

    Raises:
        UsageError: They have no specification in common, or cannot share their noise.
    """
    names = require_path(first, "a scenario file"), require_path(second, "a scenario file")
    with safe_mode(safe):
        definitions = _load_versions(names, as_settings(overrides), estimator, seed)
    scenarios = [LoadedScenario(definition) for definition in definitions]
    before, after = (
        scenario.problem(specification or scenario.definition.estimated) for scenario in scenarios
    )
    common, seed = find_common(before, after), definitions[0].seed

    def begin(number: int) -> Progress:
        label = f"{names[number]}  {number + 1} of 2"
        return watch(label, (before, after)[number]) if watch is not None else lambda info: None

    rollouts, changes = 0, list[VersionChange]()
    if estimator is None:
        rollouts = _count_rollouts(budget, before.steps)
        changes += compare_pairs(before, after, rollouts, seed, build_executor(workers), begin)
    else:
        cost = None if budget is None else parse_cost(budget)
        changes += _compare_estimates(scenarios, common, cost, workers, begin)
    return PairedComparison(names, definitions, tuple(changes), rollouts, seed)


def _load_versions(
    names: tuple[str, str], settings: Sequence[str], estimator: str | None, seed: int | None
) -> tuple[Scenario, Scenario]:
    both, second_only = _split_settings(settings)
    driver = read_driver(names[1])
    plugin, *options = (estimator or "mc").split(":")
    both += [f"estimator.{option}" for option in options] + ([] if seed is None else [f"seed={seed}"])
    return (
        load(names[0], both, estimator and plugin),
        load(names[0 if driver else 1], [*both, *driver, *second_only], estimator and plugin),
    )


def _compare_estimates(
    scenarios: Sequence[LoadedScenario],
    specifications: Sequence[str],
    budget: Budget | None,
    workers: int,
    begin: PairedWatch,
) -> Iterator[EstimatedChange]:
    results = []
    for number, scenario in enumerate(scenarios):
        display = nullcontext(begin(number))
        execution = Execution(partial(build_executor, workers), lambda *_, display=display: display)
        with _name_version(number):
            results.append(estimate_scenario(scenario, specifications, budget, execution))
    return map(EstimatedChange, specifications, zip(*results, strict=True))


def _split_settings(settings: Sequence[str]) -> tuple[list[str], list[str]]:
    both: list[str] = []
    second_only: list[str] = []
    for text in settings:
        prefix, _, rest = text.partition(".")
        if prefix not in ("scenario", "against") or not rest:
            raise UsageError(
                f"{text}: a setting of two versions begins with scenario. or against.",
                "write scenario.KEY=VALUE for both, against.KEY=VALUE for the second only",
            )
        setting = Setting(rest, f"--set {text.partition('=')[0]}")
        (both if prefix == "scenario" else second_only).append(setting)
    return both, second_only


def _count_rollouts(given: Budget | Mapping[str, float] | str | None, steps: int) -> int:
    if given is None:
        return 1000
    budget = parse_cost(given)
    rollouts = int(budget.amount // (max(steps, 1) if budget.kind == "steps" else 1))
    if rollouts < 1:
        raise UsageError(f"the budget {given} does not cover one rollout of {steps} steps")
    return rollouts


def compare_pairs(
    first: Problem,
    second: Problem,
    rollouts: int,
    seed: int,
    executor: Executor,
    watch: PairedWatch | None = None,
) -> list[PairedCounts]:
    """Simulate both problems on the same noise and count the outcomes of each common specification.

    Noise is matched by name; numbers that only one problem reads are not shared.

    Raises:
        UsageError: They have no specification in common, or different numbers of steps.
        EveryRolloutBroke: The first rollouts of a version all ended in an error.
    """
    names, shared = find_common(first, second), _share_noise(first, second)
    outcomes = []
    for number, (problem, columns) in enumerate(zip((first, second), shared, strict=True)):
        progress = watch(number) if watch else lambda info: None
        with _name_version(number):
            outcomes.append(_simulate(problem, rollouts, seed, columns, executor, progress))
    error = outcomes[0].error | outcomes[1].error
    causes = [
        f"{cause}, of the {version} version"
        for version, outcome in zip(_VERSIONS, outcomes, strict=True)
        for cause in outcome.messages[:1]
    ]
    first_failed, second_failed = (
        {name: outcome.violated[:, k] for k, name in enumerate(problem.names)}
        for outcome, problem in zip(outcomes, (first, second), strict=True)
    )
    return [
        PairedCounts.from_outcomes(name, first_failed[name], second_failed[name], error, "; ".join(causes))
        for name in names
    ]


@contextmanager
def _name_version(number: int) -> Iterator[None]:
    """Name the version in the error that all its rollouts broke down."""
    try:
        yield
    except EveryRolloutBroke as error:
        raise EveryRolloutBroke(f"{_VERSIONS[number]} version: {error.message}", error.hint) from None


def find_common(first: Problem, second: Problem) -> list[str]:
    """Return the specifications that two problems have in common.

    Raises:
        UsageError: There are none.
    """
    names = [name for name in first.names if name in second.names]
    if not names:
        raise UsageError(
            "the two scenarios have no specification in common",
            f"{', '.join(first.names)} on one side, {', '.join(second.names)} on the other",
        )
    return names


def _share_noise(first: Problem, second: Problem) -> tuple[list[int], list[int]]:
    """Return the numbers of a common tape that each problem reads: those of one name are the same number.

    Raises:
        UsageError: They have different numbers of steps.
    """
    if first.steps != second.steps:
        text = f"the two scenarios cannot share their noise: {first.steps} and {second.steps} steps"
        raise UsageError(text, "give both as many steps")
    places: dict[tuple[str, int], int] = {}
    columns = []
    for problem in (first, second):
        names = find_noise_names(problem.system)
        labels = [(name, names[:k].count(name)) for k, name in enumerate(names)]
        columns.append([places.setdefault(label, len(places)) for label in labels])
    return columns[0], columns[1]


class _SharedNoise(NoiseSource):
    # gives some of the numbers of a wider tape
    def __init__(self, seed: int, columns: Sequence[int]) -> None:
        super().__init__(seed, len(columns))
        self._wide, self._columns = NoiseSource(seed, max(columns, default=-1) + 1), columns

    def normals(self, run: ArrayLike, stage: ArrayLike, particle: ArrayLike, step: ArrayLike) -> Floats:
        return self._wide.normals(run, stage, particle, step)[..., self._columns]


def _simulate(
    problem: Problem,
    rollouts: int,
    seed: int,
    columns: Sequence[int],
    executor: Executor,
    progress: Callable[[Info], None],
) -> Rollouts:
    noise, parts, info = _SharedNoise(seed, columns), [], Info(goal=rollouts)
    rows = (np.arange(at, min(at + problem.chunk, rollouts)) for at in range(0, rollouts, problem.chunk))
    executor.open(Work(problem, noise, scored=False))
    with closing(executor):
        for part in executor.map(Request.from_start(np.zeros_like(index), index) for index in rows):
            parts.append(part)
            info = info.plus(part)
            if FIRST_ROLLOUTS <= info.errors == info.rollouts:
                raise EveryRolloutBroke.after(info.messages[0])
            progress(info)
    return Rollouts.join(parts)
