"""Confirmation of a pack by another person: fresh random numbers, and a test whether both agree.

Two estimates are compared by melding their confidence distributions, as in the gate (Fay, Proschan and
Brittain 2015). Holm's first step keeps the chance of a false alarm over all comparisons at 5 %.
"""

from __future__ import annotations

import math
import os
from collections import ChainMap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import NormalDist
from typing import Literal

from avrare.analysis.check.melded_intervals import p_value_ratio_at_least, p_value_ratio_at_most
from avrare.analysis.rates.rate import RATES, REFERENCE
from avrare.base.errors import UsageError
from avrare.base.records import Answer, Records
from avrare.base.special_functions import normal_factor
from avrare.estimation.combine.power import LEAST_POWER, MISS
from avrare.estimation.combine.specifications import Execution, Watch, show_nothing
from avrare.estimation.estimate_scenario import estimate_scenario
from avrare.estimation.plan.budget import Budget
from avrare.estimation.result.confidence_distributions import Binomial, LogNormal
from avrare.estimation.result.result import Result, Results
from avrare.estimation.result.verdict import with_verdict
from avrare.results.run import Run
from avrare.rollout.executors.work import build_executor
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load
from avrare.scenario.schema import Scenario
from avrare_evidence.manifest import (
    Pack,
    PackedRun,
    find_pack_faults,
    find_version_changes,
    hash_file,
    read_pack,
)
from avrare_evidence.sources import compute_rates, list_files

LEVEL = 0.05
"""Chance that a confirmation of the same system raises an alarm."""
_SEED_STRIDE = 1_000_003
"""Distance of the seeds of a pack's runs."""
_Law = Binomial | LogNormal
_Estimate = tuple[float, float, float, _Law]
"""Value, interval and law."""


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
    comparisons: Records
    variations: Records
    version_changes: tuple[str, ...]

    @property
    def outcome(self) -> Literal["agree", "disagree", "not decided"]:
        """Outcome; "not decided" where a change by a factor of 3 would mostly have passed unnoticed."""
        if any(row["p_value"] <= LEVEL / len(self.comparisons) for row in self.comparisons):
            return "disagree"
        return "not decided" if any(row["power"] < LEAST_POWER for row in self.comparisons) else "agree"

    def to_dict(self) -> dict[str, object]:
        """Return the content of confirmation.yaml, with blanks for the person who signs it."""
        test = f"false alarms {LEVEL:.0%} over all comparisons (Holm); power: factor {MISS:g}"
        rows = {"comparisons": [*self.comparisons], "variations": [*self.variations]}
        heads = {"outcome": self.outcome, "test": test, "seed": self.seed}
        blanks = {"name": None, "organisation": None, "date": None}
        return {**heads, **rows, "version_changes": [*self.version_changes], "signed_off": blanks}

    def table(self) -> Records:
        """Return the comparisons."""
        return self.comparisons

    def lines(self) -> list[str]:
        """Return the outcome, and the tables of comparisons and variations."""
        tables = [table for table in (self.comparisons, self.variations) if table]
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
    seeds = {name: seed + number * _SEED_STRIDE for number, name in enumerate(runs)}
    if any(entry.seed == seeds[name] for name, entry in runs.items()):
        raise UsageError(f"seed {seed} is that of the pack, whose numbers it would repeat", "choose another")
    execution = Execution(partial(build_executor, workers), watch)

    def load_all(*settings: str) -> dict[str, Scenario]:
        files = {name: pack.folder / entry.scenario for name, entry in runs.items()}
        return {name: load(file, [f"seed={seeds[name]}", *settings]) for name, file in files.items()}

    def estimate_all(scenarios: Mapping[str, Scenario]) -> dict[str, Results]:
        amounts = {name: Budget.parse(runs[name].budget if budget is None else budget) for name in scenarios}
        return {
            name: Results(
                estimate_scenario(LoadedScenario(scenario), scenario.estimated, amounts[name], execution)
            )
            for name, scenario in scenarios.items()
        }

    scenarios, varied = load_all(), load_all(*vary) if vary else {}
    for name, scenario in scenarios.items():
        _check_files(pack, runs[name], scenario)
    stored = {name: Run.read(pack.folder / entry.folder).results for name, entry in runs.items()}
    before, after = _list_estimates(pack, stored), _list_estimates(pack, estimate_all(scenarios))
    comparisons = [
        {"scenario": name, "rule": rule, **_compare(estimate, after[name, rule], LEVEL / len(before))}
        for (name, rule), estimate in before.items()
    ]
    variations = [
        {
            "scenario": name,
            "rule": rule,
            "set": ", ".join(vary),
            "value": result.probability,
            "interval": list(result.interval),
            "verdict": with_verdict(result, varied[name].thresholds).verdict,
        }
        for name, results in estimate_all(varied).items()
        for rule, result in results.items()
    ]
    return Confirmation(seed, Records(comparisons), Records(variations), tuple(changes))


def _check_files(pack: Pack, entry: PackedRun, scenario: Scenario) -> None:
    """Raise a ``UsageError`` if an option names another file than that of the pack."""
    files = ChainMap(*list_files(scenario))
    for option, copy in entry.files.items():
        if option not in files or hash_file(files[option]) != pack.manifest.files[copy]:
            text = f"{option}: the file {Path(copy).name} is missing here, or not that of the pack"
            hint = (
                "install the versions that the pack names; or call `avrare confirm ..` in its folder `repeat`"
            )
            raise UsageError(text, hint)


def _list_estimates(
    pack: Pack, results: Mapping[str, Mapping[str, Result]]
) -> dict[tuple[str, str], _Estimate]:
    """Return rates of catalogues and of their reference drivers, else probabilities, by name and rule."""
    estimates = {}
    homes = [path.removesuffix(RATES) for path in pack.manifest.files if path.endswith(f"/{RATES}")]
    for home in homes:
        name = home.removeprefix("evidence/")
        places = {f"{run.removeprefix(name)}/": results[run] for run in results if run.startswith(name)}
        rates = compute_rates(pack.folder / home / RATES, places)
        confidence = rates.catalogue.document.confidence
        largest = 1e6 * sum(exposure.high for exposure in rates.exposures)  # brings rates below 1
        for driver, side in (("", rates), (REFERENCE, rates.reference)):
            for rate in side.rates if side is not None else ():
                total = next(iter(rate.totals.values()))  # with its exposures taken as known
                numbers = (total.value, *total.sampling)
                value, low, high = (number / largest for number in numbers)
                law = _derive_law(value, low, high, confidence)
                estimates[name + driver, rate.rule] = (*numbers, law)
    for name, run in results.items():
        if not f"evidence/{name}".startswith(tuple(homes)):
            for rule, result in run.items():
                numbers, counts = (
                    (result.probability, *result.interval),
                    (result.failures.count, result.trials),
                )
                law = _derive_law(*numbers, result.confidence)
                exact = Binomial(*counts, result.errors) if result.trials else law
                estimates[name, rule] = (*numbers, exact)
    return estimates


def _derive_law(value: float, low: float, high: float, confidence: float) -> _Law:
    """Derive the law of an estimate from its interval."""
    if low <= 0.0:  # as many rollouts without a failure as give the upper end
        tail = (1.0 - confidence) / 2.0
        return Binomial(0, max(1, math.floor(math.log(tail) / math.log1p(-min(high, 1.0 - 1e-9)))))
    width = math.log(max(high / value, value / low)) / normal_factor(confidence)
    return LogNormal(value, math.expm1(width**2), 0)


def _compare(old: _Estimate, new: _Estimate, level: float) -> dict[str, object]:
    laws = new[-1], old[-1]
    p_value = 2.0 * min(p_value_ratio_at_most(1.0, *laws), p_value_ratio_at_least(1.0, *laws))
    ends = [law.interval_at(0.95) for law in laws]
    widths = [math.log(high / low) / 2.0 if low > 0.0 else math.inf for low, high in ends]
    spread = math.hypot(*widths) / normal_factor(0.95)
    power = NormalDist().cdf(math.log(MISS) / spread - normal_factor(1.0 - level))
    sides = {"pack": list(old[:3]), "fresh": list(new[:3])}
    return {**sides, "p_value": min(1.0, p_value), "power": round(power, 3)}
