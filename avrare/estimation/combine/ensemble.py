"""Estimates over an ensemble: the interval of a probability includes the uncertainty of its model.

The rollouts of the scenario's own model are reweighed for each member by the density ratio of the
observations, where enough effective failures are left; other members are simulated again.

K models are drawn from a bootstrap, or from a posterior of the true one. With p_k the probability
under model k, log p_k is taken as normal with mean mu and variance tau^2, and so is that under the true
model. What is estimated are y_k = log p_k + e_k, with errors of a known covariance C: those of members that
were reweighed from the same rollouts are correlated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from avrare.base.special_functions import bisect, chi_square_quantiles
from avrare.estimation.result import health
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.note import Note
from avrare.estimation.result.result import Result
from avrare.protocols import Floats, PerceptionErrorModel
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.problem import Problem
from avrare.rollout.weighted_problem import find_ratio_model, log_ratios


@dataclass(frozen=True)
class ModelShare:
    """Probability under several models, and the sources of its uncertainty.

    Attributes:
        probabilities: (K,) estimate under each model.
        logs: (K,) their logarithms, y.
        covariance: (K, K) of the errors of y, C.
        reused: Number of models that the same rollouts were reweighed for.
        base: Estimate under the model that the scenario names.
    """

    probabilities: Floats
    logs: Floats
    covariance: Floats
    reused: int
    base: float

    @property
    def size(self) -> int:
        """Number of models, K."""
        return len(self.logs)

    @property
    def noise(self) -> float:
        """Expected variance among the y that sampling makes: mean of C's diagonal less that of its rest."""
        diagonal = float(np.trace(self.covariance))
        rest = float(self.covariance.sum()) - diagonal
        return diagonal / self.size - rest / (self.size * (self.size - 1))

    @property
    def sampling_variance(self) -> float:
        """Variance of the mean of the y that sampling makes."""
        return float(self.covariance.sum()) / self.size**2

    @property
    def model(self) -> float:
        """Variance of log p among models, tau^2, as estimated."""
        return max(float(self.logs.var(ddof=1)) - self.noise, 0.0)

    @property
    def share(self) -> float:
        """Share of the model in the variance of the logarithm: total = model (1 + 1 / K) + sampling."""
        model = self.model * (1.0 + 1.0 / self.size)
        return model / (model + self.sampling_variance) if model + self.sampling_variance > 0.0 else 0.0

    @cached_property
    def _spreads(self) -> list[float]:
        # (K - 1) V / (tau^2 + noise) is chi-square: each of its quantiles stands for an equally likely tau.
        total = (self.size - 1) * float(self.logs.var(ddof=1)) / _chi_square(self.size - 1)
        model = np.maximum(total - self.noise, 0.0) * (1.0 + 1.0 / self.size)
        return [math.sqrt(variance) for variance in model + self.sampling_variance]

    def interval(self, confidence: float) -> Interval:
        """Return the interval of the probability under the true model.

        It is a mixture of normal laws over the possible spreads (a generalised pivot): with exact y the
        prediction interval of Student's t, with one model known exactly that of sampling.
        """
        centre, tail = float(self.logs.mean()), (1.0 - confidence) / 2.0

        def below(distance: float) -> float:
            return sum(0.5 * math.erfc(-distance / (spread * math.sqrt(2.0))) for spread in spreads) / len(
                spreads
            )

        spreads = [spread for spread in self._spreads if spread > 0.0]
        half = bisect(below, 1.0 - tail, 0.0, 40.0) if spreads else 0.0  # in logarithms
        mean = float(self.probabilities.mean())
        low, high = math.exp(centre - half), math.exp(min(centre + half, 0.0))
        return min(low, mean), max(high, mean)

    def describe(self) -> str:
        """Return the shares as a sentence."""
        percent = round(100.0 * self.share)
        model, rest = f"{percent} %", f"{100 - percent} %"
        ways = f"{self.reused} by reweighing" if self.reused else "each run anew"
        if 0 < self.reused < self.size:
            ways += f", {self.size - self.reused} run anew"
        return (
            f"Uncertainty: {model} from the model, {rest} from sampling ({self.size} models, {ways}); "
            "the interval has both."
        )

    def to_dict(self) -> dict[str, object]:
        """Return the entry of result.json."""
        return {
            "model_share": self.share,
            "sampling_share": 1.0 - self.share,
            "model_variance": self.model * (1.0 + 1.0 / self.size),
            "sampling_variance": self.sampling_variance,
            "members": self.probabilities.tolist(),
            "reweighed": self.reused,
            "base": self.base,
        }


@lru_cache(maxsize=16)
def _chi_square(freedom: int) -> Floats:
    return chi_square_quantiles(400, freedom)


RunMember = Callable[[int, str], Result]
"""Estimates a specification under a member, by number and name, with separate rollouts."""

_LEAST = 20.0
"""Effective failures that reweighing must leave,"""
_SHARE = 0.3
"""and this share of those that there are: with fewer, the weights may not have met their largest values."""


@dataclass(frozen=True)
class Reweighed:
    """Estimates under K models from the failures of one.

    Attributes:
        probabilities: (K,) estimates; NaN where too few effective failures are left.
        contributions: (F, K) part of each estimate that each failure contributes.
    """

    probabilities: Floats
    contributions: Floats


def reweigh(result: Result, log_ratio: Floats) -> Reweighed:
    """Reweigh the kept failures of a Monte Carlo estimate for K models.

    Args:
        result: Estimate under the scenario's own model.
        log_ratio: (F, K) log density ratios of the models for the observations in the failures.
    """
    count = max(len(log_ratio), 1)
    parts = np.exp(log_ratio) * (result.probability / count)
    total = parts.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        effective = total**2 / (parts**2).sum(axis=0)
    good = np.isfinite(effective) & (effective >= max(_LEAST, _SHARE * count))
    return Reweighed(np.where(good, total, np.nan), parts)


def include_model(scenario: LoadedScenario, results: Sequence[Result], run: RunMember) -> list[Result]:
    """Return the results with an interval that includes the uncertainty of the model.

    Args:
        scenario: Scenario with an ensemble.
        results: Estimates under its own model.
        run: Runs a member whose rollouts cannot be reweighed.
    """
    members = [LoadedScenario(member) for member in scenario.definition.members]
    combined = []
    for result in results:
        problem = scenario.problem(result.specification)
        others = _perceptions(problem, members) if _reweighable(scenario, result) else None
        reweighed = None
        if others is not None:
            reweighed = reweigh(result, log_ratios(problem, others, result.failures.noise))
        fresh = {
            k: run(k, result.specification)
            for k in range(len(members))
            if reweighed is None or math.isnan(reweighed.probabilities[k])
        }
        combined.append(combine(result, len(members), reweighed, fresh))
    return combined


def _reweighable(scenario: LoadedScenario, result: Result) -> bool:
    only_perception = all(path.startswith("perception.") for path in scenario.definition.ensemble)
    return only_perception and result.trials > 0 and len(result.failures.noise) >= _LEAST


def _perceptions(problem: Problem, members: Sequence[LoadedScenario]) -> list[PerceptionErrorModel] | None:
    if find_ratio_model(problem) is None:
        return None
    return [member.stack.loop.perception for member in members if member.stack.loop.perception is not None]


def combine(result: Result, size: int, reweighed: Reweighed | None, fresh: dict[int, Result]) -> Result:
    """Return a result over K models.

    Args:
        result: Estimate under the scenario's own model.
        size: K.
        reweighed: Estimates by reweighing, if any.
        fresh: Results of the models that were simulated again, by number.
    """
    share = _share(result, size, reweighed, fresh)
    errors = max(_error_share(estimate) for estimate in (result, *fresh.values()))

    doubted = [estimate for estimate in (result, *fresh.values()) if estimate.unopened_at]

    def interval_at(confidence: float) -> Interval:
        low, high = share.interval(confidence)
        ends = [(low, min(1.0, high + errors)), *(estimate.interval_at(confidence) for estimate in doubted)]
        return min(low for low, _ in ends), max(high for _, high in ends)

    runs = list(fresh.values())
    mean = float(share.probabilities.mean())
    variance = (share.model * (1.0 + 1.0 / size)) + share.sampling_variance
    warnings = {name: text for estimate in runs for name, text in estimate.health.items()} | result.health
    if min([result.failures.count, *(estimate.failures.count for estimate in runs)]) == 0:
        warnings |= health.warn("model_unknown")
    return replace(
        result,
        probability=mean,
        run_probabilities=share.probabilities,
        trials=0,
        members=size,
        interval_at=interval_at,
        relative_error=math.sqrt(math.expm1(min(variance, 50.0))) if mean else math.nan,
        rollouts=result.rollouts + sum(estimate.rollouts for estimate in runs),
        simulated_steps=result.simulated_steps + sum(estimate.simulated_steps for estimate in runs),
        errors=result.errors + sum(estimate.errors for estimate in runs),
        seconds=result.seconds + sum(estimate.seconds for estimate in runs),
        health=warnings,
        notes=(*result.notes, Note("model", share.describe())),
        diagnostics={**result.diagnostics, "model": share.to_dict()},
    )


def _error_share(result: Result) -> float:
    share = result.error_share
    return result.errors / max(result.rollouts, 1) if share is None else share


def _share(result: Result, size: int, reweighed: Reweighed | None, fresh: dict[int, Result]) -> ModelShare:
    values, covariance = np.zeros(size), np.zeros((size, size))
    logs = np.zeros(size)
    reused = [k for k in range(size) if k not in fresh]
    if reweighed is not None and reused:
        values[reused] = reweighed.probabilities[reused]
        logs[reused] = np.log(values[reused])
        parts = reweighed.contributions[:, reused] / values[reused]
        # That of the estimate itself, which all share, and that of the mean weights of the kept failures.
        covariance[np.ix_(reused, reused)] = parts.T @ parts - 1.0 / len(parts) + result.relative_error**2
    for k, estimate in fresh.items():
        values[k] = estimate.probability
        logs[k], covariance[k, k] = _log_of(estimate)
    return ModelShare(
        values, logs, covariance, len(reused) if reweighed is not None else 0, result.probability
    )


def _log_of(result: Result) -> tuple[float, float]:
    """Return the logarithm of an estimate and its variance; without failures, of half a failure."""
    if result.probability > 0.0:
        return math.log(result.probability), math.log1p(result.relative_error**2)
    return math.log(0.5 / max(result.rollouts, 1)), 2.0
