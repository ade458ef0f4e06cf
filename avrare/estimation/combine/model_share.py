"""Uncertainty of a probability that comes from its model, and that from sampling, as one interval.

K models are drawn from a bootstrap, or from a posterior of the true one. With p_k the probability
under model k, log p_k is taken as normal with mean mu and variance tau^2, and so is that under the true
model. What is estimated are y_k = log p_k + e_k, with errors of a known covariance C: those of members that
were reweighed from the same rollouts are correlated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from avrare.base.special_functions import bisect, chi_square_quantiles
from avrare.estimation.result.intervals import Interval
from avrare.protocols import Floats


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
        """K."""
        return len(self.logs)

    @property
    def noise(self) -> float:
        """Expected variance among the y that sampling makes: mean of C's diagonal less that of its rest."""
        diagonal = float(np.trace(self.covariance))
        rest = float(self.covariance.sum()) - diagonal
        return diagonal / self.size - rest / (self.size * (self.size - 1))

    @property
    def sampling(self) -> float:
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
        return model / (model + self.sampling) if model + self.sampling > 0.0 else 0.0

    @cached_property
    def _spreads(self) -> list[float]:
        # (K - 1) V / (tau^2 + noise) is chi-square: each of its quantiles stands for an equally likely tau.
        total = (self.size - 1) * float(self.logs.var(ddof=1)) / _chi_square(self.size - 1)
        model = np.maximum(total - self.noise, 0.0) * (1.0 + 1.0 / self.size)
        return [math.sqrt(variance) for variance in model + self.sampling]

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
            "sampling_variance": self.sampling,
            "members": self.probabilities.tolist(),
            "reweighed": self.reused,
            "base": self.base,
        }


@lru_cache(maxsize=16)
def _chi_square(freedom: int) -> Floats:
    return chi_square_quantiles(400, freedom)
