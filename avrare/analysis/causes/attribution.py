"""Attribution: which noise carries the failures, and how many a perfect part or another planner would save.

Let G be a group of noise numbers. Failing tapes are run again with G redrawn, and with all but G
redrawn. If S and S' are the shares of failures that stay, and p is the probability, then

    carries = (1 - S) / (1 - p),    alone = (S' - p) / (1 - p)

are the total and the first-order Sobol index of the failure indicator: the share of its variance that needs
G, and the share that G alone explains (Homma and Saltelli 1996). A failure only G can cause has both 1.
Rollouts that break down are left out of the shares; each end of an interval counts them against itself.

A part is perfect where its numbers are those at which it makes no error. Failing tapes on which a perfect
part passes are saved; fresh tapes on which only the stack with the perfect part fails count against it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from avrare.analysis.causes.failure_sample import FailureSample
from avrare.analysis.causes.noise_groups import (
    NoiseGroup,
    clip_outliers,
    count_draws,
    find_start,
    list_groups,
    make_perfect,
)
from avrare.analysis.causes.savings import Saving, measure_saving, measure_share
from avrare.analysis.causes.tape_runs import TapeRunner, Verdicts, draw_tapes
from avrare.base.errors import UsageError
from avrare.base.number_format import format_count
from avrare.base.records import Answer, Records
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.result import Result
from avrare.protocols import Floats
from avrare.rollout.problem import Problem
from avrare.stack.alternatives import list_alternatives
from avrare.stack.closed_loop import ClosedLoop

_SEED = 2**62
"""Added to the seed: fresh noise differs from that of any estimate."""
_MEDIAN_START = "start at its median"
"""It shows the failures, but mends no part: the last of the changes."""
_FRESH = 1000


@dataclass(frozen=True)
class GroupShare:
    """Share of the failures that a group of noise carries.

    Attributes:
        name: Its name.
        sort: As in ``NoiseGroup``.
        carries: Total index: share of the variance of failure that needs this noise.
        carries_interval: Its interval.
        alone: First-order index: share that this noise explains alone.
        alone_interval: Its interval.
    """

    name: str
    sort: str
    carries: float
    carries_interval: Interval
    alone: float
    alone_interval: Interval


@dataclass(frozen=True, repr=False)
class Attribution(Answer):
    """Attribution of the failures of one specification.

    Attributes:
        specification: Its name.
        shares: Shares of the groups, as they were asked for.
        savings: What perfect parts and other planners would save, the largest first, the start last.
        failures: Number of failing tapes that it rests on.
        fresh: Number of fresh tapes.
        rollouts: Rollouts that it took.
        errors: Those that broke down.
    """

    specification: str
    shares: tuple[GroupShare, ...]
    savings: tuple[Saving, ...]
    failures: int
    fresh: int
    rollouts: int
    errors: int

    def table(self) -> Records:
        """Return one row for each group of noise."""
        return Records(
            {
                "noise": share.name,
                "sort": share.sort,
                "carries": share.carries,
                "carries_low": share.carries_interval[0],
                "carries_high": share.carries_interval[1],
                "alone": share.alone,
                "alone_low": share.alone_interval[0],
                "alone_high": share.alone_interval[1],
            }
            for share in self.shares
        )

    def savings_table(self) -> Records:
        """Return one row for each perfect part."""
        return Records(
            {
                "perfect": saving.name,
                "saves": saving.saved,
                "low": saving.saved_interval[0],
                "high": saving.saved_interval[1],
                "vanish": saving.vanish,
                "vanish_low": saving.vanish_interval[0],
                "vanish_high": saving.vanish_interval[1],
                "new": saving.new,
                "new_high": saving.new_interval[1],
                "text": saving.describe(),
            }
            for saving in self.savings
        )

    def lines(self) -> list[str]:
        """Return both tables as text."""
        broken = f", {self.errors} broke down" if self.errors else ""
        counts = {"failure": self.failures, "fresh tape": self.fresh, "rollout": self.rollouts}
        cost = ", ".join(format_count(number, noun) for noun, number in counts.items()) + broken
        names = [row.name for row in self.shares] + [row.name for row in self.savings]
        width = max(map(len, names), default=0)
        lines = [f"{self.specification}: what carries the failures ({cost})"]
        lines.append(f"  {'noise':<{width}}  {'is needed for':<22}  alone explains")
        for share in self.shares:
            needed = _format(share.carries, share.carries_interval)
            lines.append(
                f"  {share.name:<{width}}  {needed:<22}  {_format(share.alone, share.alone_interval)}"
            )
        lines.append("what each change would do to the failures, on the same tapes")
        lines += [f"  {saving.name:<{width}}  {saving.describe()}" for saving in self.savings]
        return lines


def _format(value: float, interval: Interval) -> str:
    low, high = (f"{round(100 * end):,}" if np.isfinite(end) else "unknown" for end in interval)
    return f"{round(100 * value):,} % ({low} .. {high})"


def attribute(
    problem: Problem,
    sample: FailureSample,
    *,
    seed: int = 0,
    fresh: int = _FRESH,
    groups: Sequence[NoiseGroup] | None = None,
    variants: Mapping[str, Problem] | None = None,
    runner: TapeRunner | None = None,
) -> Attribution:
    """Attribute the failures of the first specification of ``problem``.

    Args:
        problem: Problem whose failures they are.
        sample: The failures, at least two.
        seed: Seed of the fresh noise.
        fresh: Fresh tapes that look for failures that a perfect part makes; 0: none, nothing is saved then.
        groups: Groups of noise; None: components, kinds of error, vehicles and time windows.
        variants: Other versions of the stack by name, which read the same tapes: "true tracks", ...
        runner: Runs the tapes; it counts them.

    Raises:
        UsageError: There are fewer than two failures, or a variant needs other noise.
    """
    if sample.size < 2:
        text = f"{problem.names[0]}: {sample.size} failure is too few to attribute"
        raise UsageError(text, "run more rollouts, or an estimator for rare events")
    run, chosen = runner or TapeRunner(), list(list_groups(problem) if groups is None else groups)
    tapes, p = sample.failures.noise, sample.probability
    drawn = draw_tapes(problem, seed + _SEED, 1, fresh)
    shares = []
    for number, group in enumerate(chosen):
        again = draw_tapes(problem, seed + _SEED, 2 + number, len(tapes))
        without = run(problem, np.where(group.mask, again, tapes), f"{group.name} drawn afresh")
        only = run(problem, np.where(group.mask, tapes, again), f"only {group.name} kept")
        shares.append(_measure_share(sample, group, without, only, p))
    base = run(problem, drawn, "fresh tapes")
    perfect = _list_perfect(problem, chosen, variants or {}, tapes, drawn)
    savings = [
        measure_saving(sample, name, run(other, some, name), base, run(other, more, name))
        for name, other, some, more in perfect
    ]
    for name, other, some, more in _list_changes(problem, tapes, drawn):
        stored = run(other, some, name)
        if not stored.broken.all():
            savings.append(measure_saving(sample, name, stored, base, run(other, more, name)))
    savings.sort(
        key=lambda saving: (saving.name == _MEDIAN_START, -(saving.saved if fresh else saving.vanish))
    )
    return Attribution(
        problem.names[0], tuple(shares), tuple(savings), sample.size, fresh, run.rollouts, run.errors
    )


def _measure_share(
    sample: FailureSample, group: NoiseGroup, without: Verdicts, only: Verdicts, p: float
) -> GroupShare:
    name = f"{group.name} drawn afresh"
    stays, (low, high) = measure_share(sample, without.fails, without.broken, name)
    alone, (alone_low, alone_high) = measure_share(sample, only.fails, only.broken, f"only {group.name} kept")
    rest = max(1.0 - p, 1e-300)
    total, total_low, total_high = np.clip((1.0 - np.array([stays, high, low])) / rest, 0.0, 1.0).tolist()
    first, first_low, first_high = np.maximum(
        (np.array([alone, alone_low, alone_high]) - p) / rest, 0.0
    ).tolist()
    return GroupShare(group.name, group.sort, total, (total_low, total_high), first, (first_low, first_high))


def _list_perfect(
    problem: Problem,
    groups: Sequence[NoiseGroup],
    variants: Mapping[str, Problem],
    tapes: Floats,
    fresh: Floats,
) -> list[tuple[str, Problem, Floats, Floats]]:
    changes = []
    for group in groups:
        if group.sort not in ("time", "start") and group.mask[:, count_draws(problem) :].any():
            changed_tapes, changed_fresh = (
                make_perfect(problem, noise, group.mask) for noise in (tapes, fresh)
            )
            word = "no" if group.name.endswith((" error", " noise")) or group.sort == "vehicle" else "perfect"
            changes.append(
                (f"{word} {group.name.removeprefix('all ')}", problem, changed_tapes, changed_fresh)
            )
    sigmas = 2.5
    changed_tapes, changed_fresh = (clip_outliers(problem, noise, sigmas) for noise in (tapes, fresh))
    changes.append((f"no noise beyond {sigmas} sigma", problem, changed_tapes, changed_fresh))
    for name, other in variants.items():
        if (other.steps, other.noise_size) != (problem.steps, problem.noise_size):
            text = f"{name}: its tapes have another shape, so nothing can be paired"
            raise UsageError(text, "change parts without noise of their own, or the options of a part")
        changes.append((name, other, tapes, fresh))
    return changes


def _list_changes(
    problem: Problem, tapes: Floats, fresh: Floats
) -> Iterator[tuple[str, Problem, Floats, Floats]]:
    """Yield the changes whose rollouts may all break down: the start at its median, and other planners."""
    start, system = find_start(problem), problem.system
    if start is not None:
        median = np.where(start.mask, 0.0, tapes), np.where(start.mask, 0.0, fresh)
        yield _MEDIAN_START, problem, *median
    if isinstance(system, ClosedLoop):
        monitors = dict(zip(problem.names, problem.monitors, strict=True))
        for name, loop in list_alternatives(system).items():
            other = Problem(
                loop,
                monitors,
                problem.steps,
                problem.score,
                chunk=problem.named_chunk,
                rollout_timeout=problem.rollout_timeout,
            )
            yield name, other, tapes, fresh


def attribution_of_result(
    result: Result, fresh: int = _FRESH, channels: bool = False, workers: int = 1, seed: int | None = None
) -> Attribution:
    """Attribute the failures of a result; without a seed the fresh noise has that of the estimate."""
    origin = result.require_origin()
    return attribute(
        origin.problem,
        FailureSample.of(result),
        seed=origin.seed if seed is None else seed,
        fresh=fresh,
        groups=list_groups(origin.problem, channels=channels),
        runner=TapeRunner(workers),
    )
