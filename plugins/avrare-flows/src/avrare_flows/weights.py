"""Weighted noise: a flow that approximates the target density, with importance weights that correct it.

A flow b maps normal numbers z to x = b(z), whose density is q(x) = N(z) / |det b'(z)|. Where the target
density P is known, a row has the weight P(x) / q(x), and a rollout the product over its rows. The weight of
stl-ess, Eq. 20, is |det b'(z)| alone: P / N is missing, and even an exact flow gets a wrong estimate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from avrare.base.errors import UsageError, did_you_mean
from avrare.base.health_messages import fill
from avrare.protocols import Bools, Floats, System, SystemWrapper, adapt
from avrare_flows.flow import Warped
from avrare_flows.health_messages import WARNINGS
from avrare_flows.laws import Law, log_normal_density
from avrare_flows.system import check_size

Weights = Literal["importance", "paper"]
WEIGHTS = ("importance", "paper")


class WarpedLaw(Law, Protocol):
    """A law with a known determinant of its map, and thus a density (``avrare_flows.flow.Flow``)."""

    def warp(self, z: Floats) -> Warped:
        """Return physical rows of standard normal rows (N, n), and log |det| (N,)."""


@dataclass(frozen=True)
class WeightedState:
    """State of the system and its weight.

    Attributes:
        state: State of the system over physical noise.
        log_weight: (N,) log of the product of the weights of all rows so far.
    """

    state: Any
    log_weight: Floats


class WeightedSystem(SystemWrapper):
    """A system whose rollouts have weights, for estimators that ask for them with ``with_weights()``.

    It refuses to run before that: an estimator that ignores the weights would give the probability under the
    flow.

    Attributes:
        system: System over physical noise.
        flow: Law that the noise is drawn from.
        log_density: Target log density of the noise, (N, n) -> (N,); None: weights as in the paper.
        first: Exact law of row 0, without weights; None: the flow.
        asked: ``with_weights`` has been called.
    """

    def __init__(
        self,
        system: System,
        flow: WarpedLaw,
        log_density: Callable[[Floats], Floats] | None,
        first: Law | None,
        asked: bool = False,
    ) -> None:
        super().__init__(system)
        self.flow, self.log_density, self.first, self.asked = flow, log_density, first, asked
        self.perfect_noise = None
        self.warnings = fill(WARNINGS, "flow_tails") if flow.note else {}
        if log_density is None:
            self.warnings = fill(WARNINGS, "paper_weights")

    def with_weights(self) -> WeightedSystem:
        """Return this system, ready to run."""
        return WeightedSystem(self.system, self.flow, self.log_density, self.first, asked=True)

    def initial(self, noise: Floats) -> WeightedState:
        """Return the state at t = 0.

        Raises:
            UsageError: The estimator has not asked for the weights.
        """
        if not self.asked:
            raise UsageError(
                "this noise has weights, which the estimator does not support",
                "use ess; to replay tapes, use avrare_flows.transform_noise(system, flow)",
            )
        if self.first is not None:
            return WeightedState(self.system.initial(self.first.physical(noise)), np.zeros(len(noise)))
        x, weight = self._warp(noise)
        return WeightedState(self.system.initial(x), weight)

    def step(self, state: WeightedState, noise: Floats) -> WeightedState:
        """Return the state one step later."""
        x, weight = self._warp(noise)
        return WeightedState(self.system.step(state.state, x), state.log_weight + weight)

    def unwrap(self, state: WeightedState) -> object:
        """Return the state of the system over physical noise."""
        return state.state

    def faults(self, state: WeightedState) -> Bools:
        """Return whether each row (N,) broke down or has a weight that is not a number."""
        broken, lost = super().faults(state), np.isnan(state.log_weight)
        return lost if broken is None else np.asarray(broken, dtype=bool) | lost

    def log_weights(self, state: WeightedState) -> Floats:
        """Return the log weights (N,)."""
        return state.log_weight

    def _warp(self, noise: Floats) -> Warped:
        x, log_det = self.flow.warp(noise)
        if self.log_density is None:
            return x, log_det
        density = np.asarray(self.log_density(x), dtype=np.float64)
        return x, density + log_det - log_normal_density(noise)


def weigh_noise(
    system: object,
    flow: WarpedLaw,
    log_density: Callable[[Floats], Floats] | None = None,
    *,
    weights: Weights = "importance",
    initial: Law | None = None,
) -> WeightedSystem:
    """Adapt a system over physical noise to a flow with weights; for the estimator ``ess``.

    Args:
        system: System whose ``initial`` and ``step`` take physical noise (N, n).
        flow: Law that the noise is drawn from.
        log_density: Target log density (N,) of rows (N, n), up to a constant. The flow must reach all rows
            where it is not -inf: others are missed.
        weights: "importance": P/q. "paper": stl-ess, Eq. 20, which is wrong, for comparison.
        initial: Exact law of row 0, where it differs.

    Raises:
        UsageError: A size or an option does not fit.
    """
    if weights not in WEIGHTS:
        raise UsageError(f"unknown weights {weights!r}", did_you_mean(str(weights), WEIGHTS))
    if (log_density is None) == (weights == "importance"):
        raise UsageError(
            "importance weights need log_density, weights as in the paper take none",
            "where only samples are known no weight helps: use avrare_flows.transform_noise(system, flow)",
        )
    physical = adapt(System, system)
    for law in (flow, initial or flow):
        check_size(law, physical.noise_size)
    return WeightedSystem(physical, flow, log_density, initial)
