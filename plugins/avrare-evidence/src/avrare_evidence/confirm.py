"""Confirmation of a pack by another person: fresh random numbers, and a test whether both agree.

Two estimates of one probability are compared by melding their confidence distributions, as in the gate (Fay,
Proschan and Brittain 2015); rates by the logarithm of their ratio. Holm's first step keeps the chance of a
false alarm over all comparisons at 5 %.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from statistics import NormalDist
from typing import Any, Literal

from avrare.analysis.check.melded_intervals import p_value_ratio_at_least, p_value_ratio_at_most
from avrare.analysis.rates.combination import FEW, Quantity, combine
from avrare.analysis.rates.scene_estimates import SceneEstimate
from avrare.base.errors import UsageError
from avrare.base.stored_files import read_json
from avrare.estimation.combine.power import LEAST_POWER, MISS, power_to_notice
from avrare.estimation.combine.specifications import Execution, Watch, show_nothing
from avrare.estimation.estimate_scenario import estimate_scenario
from avrare.estimation.loop.checkpoint import SCENARIO
from avrare.estimation.plan.budget import Budget
from avrare.estimation.result.confidence_distributions import Binomial, LogNormal
from avrare.estimation.result.result import Result, Results
from avrare.estimation.result.verdict import with_verdict
from avrare.results.run import Run
from avrare.rollout.executors.work import build_executor
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load
from avrare.scenario.schema import Scenario
from avrare_evidence.pack import Pack, PackedRun, find_pack_faults, find_version_changes, hash_file, read_pack
from avrare_evidence.sources import list_models, redirect

LEVEL = 0.05
"""Chance that a confirmation of the same system raises an alarm."""
_SEED_STRIDE = 1_000_003
"""Distance of the seeds of a pack's runs."""
Estimates = Mapping[str, Mapping[str, Result]]
"""Results by folder of the pack and rule."""
_AGAIN = "ask for the pack again"


@dataclass(frozen=True)
class Comparison:
    """Estimate of the pack beside the fresh one.

    Attributes:
        scenario: Name of the scenario, or of the catalogue.
        rule: Name of the specification.
        pack: Value and interval of the pack.
        fresh: Value and interval of this run.
        p_value: Chance of two estimates so far apart where the system is the same.
        power: Chance that a threefold value would have raised an alarm.
    """

    scenario: str
    rule: str
    pack: Quantity
    fresh: Quantity
    p_value: float
    power: float


@dataclass(frozen=True)
class Confirmation:
    """Result of a confirmation.

    Attributes:
        seed: Seed of the fresh estimates.
        comparisons: One for each rule of each scenario or catalogue.
        variations: Verdicts on the bounds under other laws or values of scene parameters.
        version_changes: Lines on distributions of another version than the pack's.
    """

    seed: int
    comparisons: tuple[Comparison, ...]
    variations: tuple[dict[str, Any], ...]
    version_changes: tuple[str, ...]

    @property
    def outcome(self) -> Literal["agree", "disagree", "not decided"]:
        """Outcome; "not decided" where a change by a factor of 3 would mostly have passed unnoticed."""
        count = len(self.comparisons)
        if count * min(comparison.p_value for comparison in self.comparisons) <= LEVEL:
            return "disagree"
        weak = any(comparison.power < LEAST_POWER for comparison in self.comparisons)
        return "not decided" if weak else "agree"

    def to_dict(self) -> dict[str, object]:
        """Return the content of confirmation.yaml, with blanks for the person who signs it."""
        count = len(self.comparisons)
        test = f"false alarms {LEVEL:.0%} over {count} comparisons (Holm); power: factor {MISS:g}"
        signed = {"name": None, "organisation": None, "date": None}
        plain = json.loads(json.dumps(asdict(self)))
        return {"outcome": self.outcome, "test": test, **plain, "signed_off": signed}


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
        raise UsageError("\n".join(f"{pack.folder}: {fault}" for fault in faults), _AGAIN)
    changes = find_version_changes(pack)
    if changes and not accept_changes:
        hint = "install the versions of the pack, or accept changes: the sheet names them"
        raise UsageError("\n".join(f"{pack.folder}: {line}" for line in changes), hint)
    runs = pack.manifest.runs
    if any(entry.seed == seed + k * _SEED_STRIDE for k, entry in enumerate(runs)):
        raise UsageError(f"seed {seed} is that of the pack, whose numbers it would repeat", "choose another")

    def estimate(number: int, settings: Sequence[str]) -> tuple[Scenario, list[Result]]:
        entry, settings = runs[number], [f"seed={seed + number * _SEED_STRIDE}", *settings]
        scenario = _load_scenario(pack, entry, settings)
        amount = Budget.parse(budget if budget is not None else entry.budget)
        execution = Execution(partial(build_executor, workers), watch)
        return scenario, estimate_scenario(LoadedScenario(scenario), scenario.estimated, amount, execution)

    stored = {entry.folder: Run.read(pack.folder / entry.folder).results for entry in runs}
    fresh = {entry.folder: Results(estimate(number, ())[1]) for number, entry in enumerate(runs)}
    varied = [estimate(number, vary) for number in range(len(runs)) if vary]
    variations = [
        {
            "scenario": scenario.name,
            "rule": result.specification,
            "set": list(vary),
            "value": result.probability,
            "interval": result.interval,
            "verdict": with_verdict(result, scenario.thresholds).verdict,
        }
        for scenario, results in varied
        for result in results
    ]
    return Confirmation(seed, tuple(_compare_all(pack, stored, fresh)), tuple(variations), tuple(changes))


def _load_scenario(pack: Pack, entry: PackedRun, settings: Sequence[str]) -> Scenario:
    file = pack.folder / entry.folder / SCENARIO
    copies = {option: str(pack.folder / copy) for option, copy in entry.files.items()}
    scenario = load(file, [*redirect(file.read_text(encoding="utf-8"), copies), *settings])
    for option, model in list_models(scenario).items():
        if not model.is_file() or hash_file(model) != hash_file(pack.folder / entry.models[option]):
            text = f"{option}: the model {model.name} is missing here, or not that of the pack"
            raise UsageError(text, "install the versions that the pack names")
    return scenario


def _compare_all(pack: Pack, stored: Estimates, fresh: Estimates) -> list[Comparison]:
    """Compare the rates of catalogues, of the reference driver's, too; else each probability."""
    rows: list[partial[Comparison]] = []
    for source in dict.fromkeys(run.source for run in pack.manifest.runs):
        home = f"evidence/{source}/"
        places = [run.folder for run in pack.manifest.runs if run.source == source]
        if f"{home}rate.json" not in pack.manifest.files:
            rows += [
                partial(_compare, place.removeprefix("evidence/"), stored[place][rule], fresh[place][rule])
                for place in places
                for rule in stored[place]
            ]
            continue
        summary = read_json(pack.folder / home / "rate.json", _AGAIN)
        driven = [place for place in places if place.startswith(f"{home}reference/")]
        for name, group in (("", [place for place in places if place not in driven]), ("reference/", driven)):
            sides = [{place: results[place] for place in group} for results in (stored, fresh)]
            rows += [
                partial(_compare_rates, f"{source}/{name}", rule["rule"], summary, sides)
                for rule in summary["rules"] * bool(group)
            ]
    return [compare(level=LEVEL / len(rows)) for compare in rows]


def _compare(name: str, old: Result, new: Result, level: float) -> Comparison:
    laws = _derive_law(new), _derive_law(old)
    p_value = min(1.0, 2.0 * min(p_value_ratio_at_most(1.0, *laws), p_value_ratio_at_least(1.0, *laws)))
    pack, here = (Quantity(result.probability, *result.interval) for result in (old, new))
    power = _find_power((old.relative_error, new.relative_error), level)
    return Comparison(name, old.specification, pack, here, p_value, power)


def _derive_law(result: Result) -> Binomial | LogNormal:
    """Derive the law of an estimate from its counts, or from the interval that is stored."""
    (low, high), tail = result.interval, (1.0 - result.confidence) / 2.0
    if result.trials:
        return Binomial(result.failures.count, result.trials, result.errors)
    if low <= 0.0:  # as many rollouts without a failure as give the upper end
        return Binomial(0, max(1, math.floor(math.log(tail) / math.log1p(-min(high, 1.0 - 1e-9)))))
    width = max(high / result.probability, result.probability / low)
    return LogNormal(
        result.probability, math.expm1((math.log(width) / NormalDist().inv_cdf(1.0 - tail)) ** 2), 0
    )


def _compare_rates(
    name: str, rule: str, summary: Mapping[str, Any], sides: Sequence[Estimates], level: float
) -> Comparison:
    """Compare the rates of a rule; the exposures are those of the pack, and count as known."""
    speed, confidence = summary["speed"] or 1.0, summary["confidence"]
    scale = {"hour": 1.0, "km": speed, "cell": 1.0}
    exposures = {x["name"]: x["exposure"]["value"] * scale[x["unit"]] for x in summary["scenes"]}
    totals = []
    for side in sides:
        scenes = {
            place: SceneEstimate(results[rule], "/own/" in place)
            for place, results in side.items()
            if rule in results
        }
        few = sum(scene.result.failures.count for scene in scenes.values() if scene.follows_counts) < FEW
        met = [Quantity(*[exposures[place.split("/")[-2]]] * 3) for place in scenes]
        total = combine(met, [scene.quantity(confidence, few) for scene in scenes.values()])
        totals.append(Quantity(total.value, *total.interval))
    factor = NormalDist().inv_cdf(0.5 + confidence / 2.0)
    errors = [math.log(x.high / x.low) / (2.0 * factor) if x.low > 0.0 else math.inf for x in totals]
    distance = math.log(totals[1].value / totals[0].value) if math.isfinite(sum(errors)) else 0.0
    p_value = 2.0 * NormalDist().cdf(-abs(distance) / math.hypot(*errors))
    power = _find_power([math.sqrt(math.expm1(x**2)) if x < 5.0 else math.inf for x in errors], level)
    return Comparison(name, rule, totals[0], totals[1], p_value, power)


def _find_power(errors: Sequence[float], level: float) -> float:
    spread = math.sqrt(sum(math.log1p(error**2) for error in errors))
    if not math.isfinite(spread):
        return 0.0
    threshold = math.exp(NormalDist().inv_cdf(1.0 - level / 2.0) * spread)
    return round(power_to_notice(threshold, (errors[0], errors[1])), 3)
