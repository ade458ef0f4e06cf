"""Confirmation of a pack by another person: fresh random numbers, and a test whether both agree.

Two estimates are compared by the logarithm of their ratio, with the ends of both intervals that face each
other (MOVER, Zou and Donner 2008), as a cross-check is. Holm's first step keeps the chance of a false alarm
over all comparisons at 5 %.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from statistics import NormalDist
from typing import Any, Literal

from avrare.base.errors import UsageError
from avrare.base.records import Answer, Records
from avrare.base.special_functions import normal_factor
from avrare.estimation.combine.specifications import Execution, Watch, show_nothing
from avrare.estimation.combine.witnesses import LEAST_POWER, MISS
from avrare.estimation.estimate import estimate_scenario
from avrare.estimation.plan.budget import Budget
from avrare.estimation.result.intervals import divide_estimates
from avrare.estimation.result.result import Results, finite
from avrare.estimation.result.verdict import with_verdict
from avrare.results.run import Run
from avrare.rollout.executors.work import build_executor
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load
from avrare_evidence.pack import Pack, name_scenario
from avrare_evidence.sources import MANIFEST, Estimate, Source, list_claims, read_source

LEVEL = 0.05
"""Chance that a confirmation of the same system raises an alarm."""


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
        tables = [repr(Records(rows)) for rows in (self.comparisons, self.variations) if rows]
        return [self.outcome, *"\n".join(tables).splitlines()]


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
    pack = Pack.read(folder)
    changes = pack.find_version_changes()
    _refuse(pack, pack.find_faults(), "ask for the pack again")
    hint = "install the versions of the pack, or accept changes: the sheet names them"
    _refuse(pack, [] if accept_changes else changes, hint)
    homes = dict.fromkeys(name.partition("/")[0] for name in pack.manifest.runs)
    sources = [read_source(pack.folder / "evidence" / home) for home in homes]
    runs = {name: run for source in sources for name, run in source.runs.items()}
    others = sorted(runs.keys() ^ pack.manifest.runs.keys())
    _refuse(pack, [f"{MANIFEST}: does not fit the run {name}" for name in others], "ask for the pack again")
    seeds = _assign_seeds(runs, seed)
    scenarios = {
        (text, name): load(pack.folder / name_scenario(name), [f"seed={seeds[name]}", *words])
        for text, words in {"": (), ", ".join(vary): vary}.items()
        for name in runs
    }
    hint = "install the versions of the pack, or call `avrare confirm ..` in its folder `repeat`"
    for (_, name), scenario in scenarios.items():
        _refuse(pack, pack.find_other_files(name, scenario), hint)
    execution, fresh, variations = Execution(partial(build_executor, workers), watch), dict[str, Run](), []
    for (text, name), scenario in scenarios.items():
        amount = Budget.parse(runs[name].provenance.budget if budget is None else budget)
        results = estimate_scenario(LoadedScenario(scenario), scenario.estimated, amount, execution)
        run = replace(runs[name], results=Results(with_verdict(r, scenario.thresholds) for r in results))
        if text:
            variations += [{"scenario": name, "set": text, **finite(row)} for row in run.table()]
        else:
            fresh[name] = run
    repeats = [replace(source, runs={name: fresh[name] for name in source.runs}) for source in sources]
    before, after = _list_estimates(sources), _list_estimates(repeats)
    comparisons = [
        {"scenario": name, "rule": rule, **_compare(estimate, after[name, rule], LEVEL / len(before))}
        for (name, rule), estimate in before.items()
    ]
    return Confirmation(seed, comparisons, variations, changes)


def _assign_seeds(runs: Mapping[str, Run], seed: int) -> dict[str, int]:
    stride = 1_000_003  # distance of the seeds of a pack's runs
    seeds = {name: seed + number * stride for number, name in enumerate(runs)}
    if any(run.seed == seeds[name] for name, run in runs.items()):
        raise UsageError(f"seed {seed} is that of the pack, whose numbers it would repeat", "choose another")
    return seeds


def _refuse(pack: Pack, faults: Sequence[str], hint: str) -> None:
    if faults:
        raise UsageError("\n".join(f"{pack.folder}: {fault}" for fault in faults), hint)


def _list_estimates(sources: Sequence[Source]) -> dict[tuple[str, str], Estimate]:
    claims = [claim for source in sources for claim in list_claims(source)]
    return {(claim.name, claim.measure.rule): claim.estimate for claim in claims}


def _compare(before: Estimate, after: Estimate, level: float) -> dict[str, object]:
    # half a failure, which takes the place of none on a logarithm, over the upper limit of none at 95 %
    zero_share = 0.135
    small, large = sorted((value or high * zero_share, low, high) for value, low, high, _ in (before, after))
    ratio, (least, _) = large[0] / small[0], divide_estimates(large, small)
    sd = math.log(ratio / least) / normal_factor(before[3]) if least else math.inf
    return {
        "pack": before[0],
        "pack_interval": list(before[1:3]),
        "fresh": after[0],
        "fresh_interval": list(after[1:3]),
        "p_value": 2.0 * NormalDist().cdf(-math.log(ratio) / sd),
        "power": round(NormalDist().cdf(math.log(MISS) / sd - normal_factor(1.0 - level)), 3),
    }
