"""Closed loop with weights: the system of importance sampling over perception error models.

Particles are drawn from the proposal (or from the target) and carry the running sum of
log p_target(observation | world) - log p_proposal(observation | world), the log of their likelihood ratio.
Both densities are evaluated on the same worlds and the same observations, whichever model drew them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.protocols import AdaptsToTarget, Bools, Floats, Signals, find_ability
from avrare.stack.closed_loop import ClosedLoop, LoopState


@dataclass(frozen=True)
class SamplingLaw:
    """Distribution that the rows of a request are drawn from (``Request.law``).

    Attributes:
        proposal: Perception error model, or a recipe for one (``AdaptsToTarget``); None: the problem's own.
        from_target: Draw from the target instead, and weigh against the proposal all the same.
    """

    proposal: Any = None
    from_target: bool = False


@dataclass(frozen=True)
class WeightedLoopState:
    """State of the closed loop and its weight.

    Attributes:
        loop: World, observation, track and memory.
        log_weight: (N,) log of the likelihood ratio of all observations so far.
    """

    loop: LoopState
    log_weight: Floats


class WeightedLoop:
    """Closed loop under a proposal; without ``under`` it is the target itself.

    Args:
        target: Closed loop whose perception error model has ``log_prob``.
        proposal: Perception error model to draw from, or None where each request brings its own.
        law: Distribution to draw from; None: the target, unweighted.
    """

    def __init__(self, target: ClosedLoop, proposal: Any = None, law: SamplingLaw | None = None) -> None:
        self.target, self.proposal, self.law = target, proposal, law
        self._density = self._proposal_density(law)
        draws_target = law is None or law.from_target
        self._drawn = target
        if not draws_target:
            self._drawn = ClosedLoop(target.simulator, self._density, target.tracker, target.controller)
        own = target.simulator.noise_size
        self.noise_size = max(target.noise_size, own + (proposal.noise_size if proposal is not None else 0))

    def _proposal_density(self, law: SamplingLaw | None) -> Any:
        if law is None:
            return None
        proposal = law.proposal if law.proposal is not None else self.proposal
        recipe = find_ability(proposal, AdaptsToTarget)
        return proposal if recipe is None else recipe.for_target(self.target.perception)

    def under(self, law: SamplingLaw) -> WeightedLoop:
        """Return the same loop drawn from ``law``."""
        return WeightedLoop(self.target, self.proposal, law)

    def initial(self, noise: Floats) -> WeightedLoopState:
        """Return the state at t = 0 from noise (N, noise_size)."""
        return WeightedLoopState(self._drawn.initial(self._own(noise)), np.zeros(len(noise)))

    def step(self, state: WeightedLoopState, noise: Floats) -> WeightedLoopState:
        """Return the state one step later."""
        loop = self._drawn.step(state.loop, self._own(noise))
        if self._density is None:
            return replace(state, loop=loop)
        target: Any = self.target.perception
        ratio = target.log_prob(loop.world, loop.observation) - self._density.log_prob(
            loop.world, loop.observation
        )
        return WeightedLoopState(loop, state.log_weight + ratio)

    def signals(self, state: WeightedLoopState) -> Signals:
        """Return the simulator's signals."""
        return self.target.signals(state.loop)

    def faults(self, state: WeightedLoopState) -> Bools:
        """Return (N,) rows that broke down, or whose observation has density 0 under both models."""
        return np.asarray(self.target.faults(state.loop) | np.isnan(state.log_weight))

    def counts(self, state: WeightedLoopState) -> dict[str, NDArray[np.int64]]:
        """Return the counters of the simulator and the controller."""
        return self.target.counts(state.loop)

    def log_weights(self, state: WeightedLoopState) -> Floats:
        """Return (N,) log of the likelihood ratio."""
        return state.log_weight

    def _own(self, noise: Floats) -> Floats:
        # Models may need different many numbers.
        return noise[:, : self._drawn.noise_size]
