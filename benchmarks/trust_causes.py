"""The ten causes of confident wrong numbers, each measured on the present code (docs/trust.md).

    OMP_NUM_THREADS=1 python -m studies.check_costs       # in benchmarks/: what the checks cost
    OMP_NUM_THREADS=1 python benchmarks/trust_causes.py   # writes docs/trust.md

A few minutes of one core. The page's text is ``studies/trust.md``; its figures of the first release are those
of the attack that found the causes. The study of all problems, with 300 results each, is ``untuned.py``.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np
from gate import drift
from scipy import stats
from studies import check_costs, pages
from studies.run_intervals import interval_of_runs
from studies.untuned_problems import untuned_problem
from untuned import Outcome

import avrare
from avrare.analysis.compare.paired_comparison import PairedCounts
from avrare.estimation import health, intervals
from avrare.protocols import Floats
from avrare.rollout.problem import Problem

PAGE = Path(__file__).parent.parent / "docs" / "trust.md"
TEMPLATE = Path(__file__).parent / "studies" / "trust.md"
_RUNS, _SAMPLES = 40, 1000
"""Runs of splitting on hidden regimes, and samples of ten of them."""


def shares(problem: str, estimator: str, seeds: int) -> str:
    """Return what default results on a problem with an exact answer are worth."""
    known, found = untuned_problem(problem), []
    for seed in range(seeds):
        one = avrare.estimate(known.problem(), estimator, seed=seed)
        found.append(
            Outcome(
                seed, one.probability, *one.interval, one.blind_bound or 0.0, one.rollouts, tuple(one.health)
            )
        )
    truth = known.probability
    quiet = [one for one in found if not one.warnings]
    wrong = sum(one.far_off(truth) for one in quiet)
    unsaid = sum(one.far_off(truth) and max(one.high, one.blind) * 3.0 < truth for one in quiet)
    held = sum(one.covers(truth) for one in quiet)
    mean = sum(one.probability for one in found) / seeds / truth
    warned = f"{seeds} results: mean/p {mean:.2f}, {seeds - len(quiet)} warned"
    if not quiet:
        return warned
    beyond = (
        f" ({unsaid} beyond the bound for failures that the score does not lead to, too)" if wrong else ""
    )
    fates = f"{held} cover and {wrong} miss by a factor 3"
    return f"{warned}; of the {len(quiet)} unwarned intervals {fates}{beyond}"


@cache
def samples() -> tuple[float, Floats, Floats]:
    """Return the mean of many runs, and (samples, 10) probabilities and roots of samples of them.

    The size of the runs is the one that the pilot chose.
    """
    known = untuned_problem("regimes_1e-5")
    result = avrare.estimate(known.problem(), "ams", runs=_RUNS)
    chosen = np.random.default_rng(0).integers(0, _RUNS, (_SAMPLES, 10))
    return result.probability, result.run_probabilities[chosen], np.array(result.diagnostics["roots"])[chosen]


def selection() -> str:
    """Return what the warnings select among samples of ten runs."""
    truth, values, roots = samples()
    covers, warned = [], []
    for ten, their in zip(values, roots, strict=True):
        low, high = interval_of_runs(ten, 250)(0.95)
        covers.append(low <= truth <= high)
        found = health.check_runs(ten.tolist(), int((ten == 0.0).sum()), their.astype(int).tolist())
        warned.append(bool(found))
    held, told = np.array(covers), np.array(warned)
    quiet = f"{held[~told].mean():.3f}" if (~told).any() else "no sample is unwarned"
    return (
        f"hidden regimes, p = 1e-5, {_RUNS} runs of the size that the pilot chose, with "
        f"{np.median(roots):.0f} roots and a mean of {truth / 1e-5:.2f} p, which counts as the truth: "
        f"{told.mean():.0%} of the samples of ten runs are warned; all cover {held.mean():.3f}, "
        f"the unwarned {quiet}"
    )


def laws() -> str:
    """Return the coverage of the interval and of the former one, on the same samples."""
    truth, values, _ = samples()
    now, former = [], []
    for ten in values:
        low, high = interval_of_runs(ten, 250)(0.95)
        now.append(low <= truth <= high)
        relative = float((ten / ten.mean()).var(ddof=1)) / len(ten)
        low, high = intervals.log_normal(float(ten.mean()), relative, 0.95, freedom=len(ten) - 1)
        former.append(low <= truth <= high)
    return f"same samples as cause 4: {np.mean(now):.3f}, where the former interval has {np.mean(former):.3f}"


def drifts() -> str:
    """Return how far a stack drifts by 10 % a commit before a check fails."""
    ends = []
    for first in (True, False):
        rng = np.random.default_rng(0)
        reached = np.quantile([drift(rng, first) for _ in range(40)], (0.5, 0.9))
        ends.append(f"{reached[0]:.2f} times in the median, {reached[1]:.2f} times for a tenth")
    return (
        f"+10 % a commit fails at {ends[0]}; without the first baseline at {ends[1]}. Error rates of `mc`, "
        "`ams` and `ess`: [CI](ci.md#cost)"
    )


def paired() -> str:
    """Return the exact coverage of the interval of a change, at three shares of differing rollouts."""
    found = []
    for worse, better in ((0.3, 0.1), (0.35, 0.25), (0.6, 0.3)):
        covered, rollouts = 0.0, 40
        for differ in range(rollouts + 1):
            for count in range(differ + 1):
                low, high = PairedCounts("", 0, differ - count, count, rollouts - differ).interval(0.95)
                chance = stats.binom.pmf(differ, rollouts, worse + better)
                chance *= stats.binom.pmf(count, differ, worse / (worse + better))
                covered += chance * (low <= worse - better <= high)
        found.append(f"{covered:.3f}")
    return f"{' / '.join(found)} at .4 / .6 / .9 (sums over all outcomes of 40 rollouts)"


def binomial() -> str:
    """Return the least exact coverage of Clopper and Pearson's interval over p."""
    trials, least = 100, []
    for confidence in (0.95, 0.9):
        ends = np.array([intervals.clopper_pearson(k, trials, confidence) for k in range(trials + 1)])
        grid = np.linspace(1e-4, 0.2, 2000)[:, None]
        held = (ends[:, 0] <= grid) & (grid <= ends[:, 1])
        covered = (stats.binom.pmf(np.arange(trials + 1), trials, grid) * held).sum(axis=1)
        least.append(float(covered.min()))
    return f"at least {least[0]:.3f} at 95 %, {least[1]:.3f} at 90 % (100 rollouts, p up to 0.2)"


class Walk:
    """Random walk."""

    noise_size = 1

    def initial(self, noise: Floats) -> dict[str, Floats]:
        """Start at 0."""
        return {"x": np.zeros(len(noise))}

    def step(self, state: dict[str, Floats], noise: Floats) -> dict[str, Floats]:
        """Add the noise."""
        return {"x": state["x"] + 0.3 * noise[:, 0]}

    def signals(self, state: dict[str, Floats]) -> dict[str, Floats]:
        """Show the position."""
        return {"x": state["x"]}


class InPlace(Walk):
    """Changes the state that it is given."""

    def step(self, state: dict[str, Floats], noise: Floats) -> dict[str, Floats]:
        """Add the noise to the array itself."""
        state["x"] += 0.3 * noise[:, 0]
        return state


class Draws(Walk):
    """Draws numbers of its own."""

    def step(self, state: dict[str, Floats], noise: Floats) -> dict[str, Floats]:
        """Add numbers that no tape has."""
        return {"x": state["x"] + 0.3 * np.random.normal(size=len(noise))}


def rule_breakers() -> str:
    """Return what splitting and Monte Carlo say of systems that break the rules."""
    told = []
    for name, system in (("in place", InPlace()), ("`np.random`", Draws())):
        problem = Problem(system, avrare.stl("always (x < 4)"), 20)
        try:
            splitting = str(avrare.estimate(problem, "ams", particles=50, discard=5).probability)
        except avrare.UsageError:
            splitting = "refused, with the reason"
        counted = avrare.estimate(problem, "mc", rollouts=100).health
        told.append(f"{name}: `ams` {splitting}; `mc` {', '.join(f'`{one}`' for one in counted) or 'sound'}")
    return ". ".join(told)


MEASURES: tuple[Callable[[], str], ...] = (
    partial(shares, "static_late", "ce", 30),
    partial(shares, "units_100", "ams", 5),
    partial(shares, "static_flat", "ess", 60),
    selection,
    laws,
    drifts,
    paired,
    binomial,
    partial(shares, "boolean_eventually", "ams", 5),
    rule_breakers,
)


def main() -> None:
    """Fill the figures into the page."""
    text = TEMPLATE.read_text(encoding="utf-8")
    for number, measure in enumerate(MEASURES, start=1):
        figure = measure()
        print(f"{number}. {figure}", flush=True)
        text = text.replace(f"[now {number}]", figure)
    if not check_costs.FILE.exists():
        check_costs.main()
    text = text.replace("[costs]", check_costs.FILE.read_text(encoding="utf-8").strip())
    pages.put(PAGE, text, check_costs.FILE.parent)


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main()
