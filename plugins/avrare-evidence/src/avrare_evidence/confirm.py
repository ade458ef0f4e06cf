"""Confirmation of a pack by another person: fresh random numbers, and a test whether both agree.

Two estimates are compared by the logarithm of their ratio, with the ends of both intervals that face each
other (MOVER, Zou and Donner 2008), as a cross-check is. Holm's first step keeps the chance of a false alarm
over all comparisons at 5 %.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import NormalDist
from typing import Any, Literal

from avrare.analysis.rates.rate import RATES, REFERENCE
from avrare.base.errors import UsageError
from avrare.base.records import Answer, Records
from avrare.base.special_functions import normal_factor
from avrare.estimation.combine.specifications import Execution, Watch, show_nothing
from avrare.estimation.combine.witnesses import LEAST_POWER, MISS
from avrare.estimation.estimate import estimate_scenario
from avrare.estimation.plan.budget import Budget
from avrare.estimation.result.result import Result, Results, finite
from avrare.estimation.result.verdict import with_verdict
from avrare.results.run import Run
from avrare.rollout.executors.work import build_executor
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load
from avrare.scenario.schema import Scenario
from avrare_evidence.pack import (
    Pack,
    find_pack_faults,
    find_version_changes,
    hash_file,
    list_files,
    read_pack,
)
from avrare_evidence.sources import read_rates

LEVEL = 0.05
"""Chance that a confirmation of the same system raises an alarm."""
_Estimate = tuple[float, float, float, float]
"""Value, interval and its confidence."""


@dataclass(frozen=True, repr=False)
class Confirmation(Answer):
    """Result of a confirmation.

    Attributes:
        seed: Seed of the fresh estimates.
        comparisons: Row for each rule of each scenario or catalogue: value and interval of the pack and of
            the fresh estimate, chance of two so far apart where the system is the same, and chance that a
            threefold value would have raised an alarm.
        variations: Row for each rule under other laws or values of scene parameters, with its verdict.
        version_changes: Lines on distributions of another version than the pack's.
    """

    seed: int
    comparisons: Sequence[Mapping[str, Any]]
    variations: Sequence[Mapping[str, Any]]
    version_changes: Sequence[str]

    @property
    def outcome(self) -> Literal["agree", "disagree", "not decided"]:
        """Outcome; "not decided" where a change by a factor of 3 would mostly have passed unnoticed."""
        if any(row["p_value"] <= LEVEL / len(self.comparisons) for row in self.comparisons):
            return "disagree"
        return "not decided" if any(row["power"] < LEAST_POWER for row in self.comparisons) else "agree"

    def to_dict(self) -> dict[str, object]:
        """Return the content of confirmation.yaml, with blanks for the person who signs it."""
        test = f"false alarms {LEVEL:.0%} over all comparisons (Holm); power: factor {MISS:g}"
        blanks = {"name": None, "organisation": None, "date": None}
        return {"outcome": self.outcome, "test": test, **vars(self), "signed_off": blanks}

    def table(self) -> Records:
        """Return the comparisons."""
        return Records(self.comparisons)

    def lines(self) -> list[str]:
        """Return the outcome, and the tables of comparisons and variations."""
        tables = [Records(rows) for rows in (self.comparisons, self.variations) if rows]
        return [self.outcome, *(line for table in tables for line in repr(table).splitlines())]


def confirm(
    folder: str | os.PathLike[str],
    seed: int = 1,
    *,
    budget: Budget | Mapping[str, float] | str | None = None,
    vary: Sequence[str] = (),
    workers: int = 1,
    accept_changes: bool = False,
    watch: Watch = show_nothing,
) -> Confirmation:
    """Estimate all claims of a pack again with another seed.

    Args:
        folder: Folder of the pack.
        seed: Seed, other than those of the pack.
        budget: Budget of each estimate; default: that of the pack.
        vary: ``KEY=LAW`` or ``KEY=VALUE``, scene parameters under which the bounds are judged once more.
        workers: Number of processes; changes no number.
        accept_changes: Go on where versions of distributions differ; the sheet names them.
        watch: Progress display.

    Raises:
        UsageError: A file of the pack has changed, a model or version differs, or the seed is the pack's.
    """
    pack = read_pack(folder)
    if faults := find_pack_faults(pack):
        raise UsageError("\n".join(f"{pack.folder}: {fault}" for fault in faults), "ask for the pack again")
    changes = find_version_changes(pack)
    if changes and not accept_changes:
        hint = "install the versions of the pack, or accept changes: the sheet names them"
        raise UsageError("\n".join(f"{pack.folder}: {line}" for line in changes), hint)
    runs = {entry.name: entry for entry in pack.manifest.runs}
    stride = 1_000_003  # distance of the seeds of a pack's runs
    seeds = {name: seed + number * stride for number, name in enumerate(runs)}
    if any(entry.seed == seeds[name] for name, entry in runs.items()):
        raise UsageError(f"seed {seed} is that of the pack, whose numbers it would repeat", "choose another")
    execution = Execution(partial(build_executor, workers), watch)

    settings = {"": [], ", ".join(vary): vary}
    scenarios = {
        (text, name): load(pack.folder / entry.scenario, [f"seed={seeds[name]}", *words])
        for text, words in settings.items()
        for name, entry in runs.items()
    }
    for (_, name), scenario in scenarios.items():
        _check_files(pack, runs[name].files, scenario)
    estimates = {}
    for (text, name), scenario in scenarios.items():
        amount = Budget.parse(runs[name].budget if budget is None else budget)
        results = estimate_scenario(LoadedScenario(scenario), scenario.estimated, amount, execution)
        estimates[text, name] = Results(with_verdict(result, scenario.thresholds) for result in results)
    stored = {name: Run.read(pack.folder / entry.folder) for name, entry in runs.items()}
    before = _list_estimates(pack, stored)
    after = _list_estimates(pack, {name: estimates["", name] for name in runs})
    comparisons = [
        {"scenario": name, "rule": rule, **_compare(estimate, after[name, rule], LEVEL / len(before))}
        for (name, rule), estimate in before.items()
    ]
    variations = [
        {"scenario": name, "set": text, **finite(row)}
        for (text, name), results in estimates.items()
        if text
        for row in results.table()
    ]
    return Confirmation(seed, comparisons, variations, changes)


def _check_files(pack: Pack, copies: Mapping[str, str], scenario: Scenario) -> None:
    """Raise a ``UsageError`` if an option names another file than that of the pack."""
    paths = {option: path for files in list_files(scenario) for option, path in files.items()}
    for option, copy in copies.items():
        if option not in paths or hash_file(paths[option]) != pack.manifest.files[copy]:
            text = f"{option}: the file {Path(copy).name} is missing here, or not that of the pack"
            hint = "install the versions of the pack, or call `avrare confirm ..` in its folder `repeat`"
            raise UsageError(text, hint)


def _list_estimates(
    pack: Pack, results: Mapping[str, Mapping[str, Result]]
) -> dict[tuple[str, str], _Estimate]:
    """Return rates of catalogues and reference drivers, or probabilities, by name and rule."""
    estimates: dict[tuple[str, str], _Estimate] = {}
    for source in dict.fromkeys(name.partition("/")[0] for name in results):
        runs = {name: run for name, run in results.items() if f"{name}/".startswith(f"{source}/")}
        file = f"evidence/{source}/{RATES}"
        if file not in pack.manifest.files:
            estimates |= {
                (name, rule): (result.probability, *result.interval, result.confidence)
                for name, run in runs.items()
                for rule, result in run.items()
            }
            continue
        places = {f"{name.removeprefix(f'{source}/')}/": run for name, run in runs.items()}
        rates = read_rates(pack.folder / file, places)
        for driver, side in ((source, rates), (f"{source}/{REFERENCE}", rates.reference)):
            for rate in side.rates if side is not None else ():
                total = next(iter(rate.totals.values()))  # with its exposures taken as known
                confidence = rates.catalogue.document.confidence
                estimates[driver, rate.rule] = (total.value, *total.sampling, confidence)
    return estimates


def _compare(before: _Estimate, after: _Estimate, level: float) -> dict[str, object]:
    # half a failure, which takes the place of none on a logarithm, over the upper limit of none at 95 %
    zero_share = 0.135
    (small, _, top, confidence), (large, bottom, *_) = sorted(
        (value or high * zero_share, low, high, confidence)
        for value, low, high, confidence in (before, after)
    )
    reach = math.hypot(math.log(top / small), math.log(large / bottom) if bottom > 0.0 else math.inf)
    distances = [math.log(ratio) * normal_factor(confidence) / reach for ratio in (large / small, MISS)]
    return {
        "pack": before[0],
        "pack_interval": list(before[1:3]),
        "fresh": after[0],
        "fresh_interval": list(after[1:3]),
        "p_value": 2.0 * NormalDist().cdf(-distances[0]),
        "power": round(NormalDist().cdf(distances[1] - normal_factor(1.0 - level)), 3),
    }
