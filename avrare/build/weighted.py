"""A closed loop seen through another perception model, with weights: the system of importance sampling.

Particles are drawn from the proposal (or from the target) and carry the running sum of
log p_target(observation | world) - log p_proposal(observation | world), the log of their likelihood ratio.
Both densities are evaluated on the same worlds and the same observations, whoever drew them.

Errors that last are refused. The density of an observation would have to be that given all earlier ones, and
a miss says no more of what lasts than that it lies beyond a bound: an integral over all its paths.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.build.closed_loop import ClosedLoop, LoopState
from avrare.errors import PluginError, UsageError, did_you_mean
from avrare.protocols import Bools, Floats, PersistentPerceptionErrorModel, Signals
from avrare.rollout.problem import Problem


@dataclass(frozen=True)
class Law:
    """What the rows of a request are drawn from (``Request.law``).

    Attributes:
        proposal: Perception model, or an object with ``of(target)`` that gives one; None: the problem's own.
        from_target: Draw from the target instead, and weigh against the proposal all the same.
    """

    proposal: Any = None
    from_target: bool = False


@dataclass(frozen=True)
class WeightedState:
    """State of the closed loop and its weight.

    Attributes:
        loop: World, observation, track and memory.
        log_weight: (N,) log of the likelihood ratio of all observations so far.
    """

    loop: LoopState
    log_weight: Floats


class WeightedLoop:
    """A closed loop under a proposal; without ``under`` it is the target itself.

    Args:
        target: The closed loop; its perception has ``log_prob``.
        proposal: Perception model to draw from, or None where each request brings its own.
        law: What to draw from; None: the target, unweighted.
    """

    def __init__(self, target: ClosedLoop, proposal: Any = None, law: Law | None = None) -> None:
        self.target, self.proposal, self.law = target, proposal, law
        self._density = self._resolved(law)
        draws_target = law is None or law.from_target
        self._drawn = target if draws_target else _with_perception(target, self._density)
        widest = max(target.noise_size, target.simulator.noise_size + getattr(proposal, "noise_size", 0))
        self.noise_size = widest

    def _resolved(self, law: Law | None) -> Any:
        """The perception model whose density divides."""
        if law is None:
            return None
        proposal = law.proposal if law.proposal is not None else self.proposal
        of = getattr(proposal, "of", None)
        return proposal if of is None else of(self.target.perception)

    def under(self, law: Law) -> WeightedLoop:
        """The same loop drawn from ``law``."""
        return WeightedLoop(self.target, self.proposal, law)

    def initial(self, noise: Floats) -> WeightedState:
        """State at t = 0 from noise (N, noise_size)."""
        return WeightedState(self._drawn.initial(self._own(noise)), np.zeros(len(noise)))

    def step(self, state: WeightedState, noise: Floats) -> WeightedState:
        """State one step later."""
        loop = self._drawn.step(state.loop, self._own(noise))
        if self._density is None:
            return replace(state, loop=loop)
        target: Any = self.target.perception
        ratio = target.log_prob(loop.world, loop.observation) - self._density.log_prob(
            loop.world, loop.observation
        )
        return WeightedState(loop, state.log_weight + ratio)

    def signals(self, state: WeightedState) -> Signals:
        """The simulator's signals."""
        return self.target.signals(state.loop)

    def faults(self, state: WeightedState) -> Bools:
        """(N,) rows that broke down, or that no model could have drawn."""
        return np.asarray(self.target.faults(state.loop) | np.isnan(state.log_weight))

    def counts(self, state: WeightedState) -> dict[str, NDArray[np.int64]]:
        """The controller's counters."""
        return self.target.counts(state.loop)

    def log_weights(self, state: WeightedState) -> Floats:
        """(N,) log of the likelihood ratio."""
        return state.log_weight

    def _own(self, noise: Floats) -> Floats:
        """The numbers that the perception in use reads: models may need different many."""
        return noise[:, : self._drawn.noise_size]


def _with_perception(loop: ClosedLoop, perception: Any) -> ClosedLoop:
    return ClosedLoop(loop.simulator, perception, loop.tracker, loop.controller)


class WeightedProblem(Problem):
    """A problem whose closed loop can be drawn from other perception models.

    It travels to a worker as its target (a problem from a scenario: as its recipe) and the proposal.

    Args:
        target: Its system is a ``ClosedLoop`` whose perception has ``log_prob``.
        proposal: Perception model; or a block ``{"plugin": name, ...}`` that is built for the target's
            scene; or None where each request brings its own.
        needs: What the perception must offer for it to be weighed.

    Raises:
        UsageError: The target has no such perception, or the block does not fit.
        PluginError: Nobody provides the block's plugin.
    """

    def __init__(self, target: Problem, proposal: Any = None, needs: str = "log_prob") -> None:
        loop = _checked_loop(target, needs)
        self.target, self.proposal, self.needs = target, proposal, needs
        built = _built(proposal, loop) if isinstance(proposal, Mapping) else proposal
        monitors = dict(zip(target.names, target.specifications, strict=True))
        _check_memoryless(built)
        super().__init__(WeightedLoop(loop, built), monitors, target.steps, chunk=target.chunk)

    def __reduce__(self) -> tuple[Any, ...]:
        return WeightedProblem, (self.target, self.proposal, self.needs)


def _checked_loop(target: Problem, needs: str) -> ClosedLoop:
    loop = target.system
    if not isinstance(loop, ClosedLoop):
        raise UsageError(
            f"a perception model as proposal needs a closed loop, but the system is a {type(loop).__name__}",
            "give a proposal of the noise: an object with sample(rng, n) and log_ratio(noise)",
        )
    _check_memoryless(loop.perception)
    if not hasattr(loop.perception, needs):
        what = "no perception model" if loop.perception is None else f"{type(loop.perception).__name__}"
        lacks = "" if loop.perception is None else f", which has no {needs}"
        raise UsageError(
            f"the likelihood ratio is unknown: the closed loop has {what}{lacks}",
            "choose a perception model with log_prob(world, observation), or a proposal of the noise",
        )
    return loop


def _check_memoryless(perception: Any) -> None:
    if isinstance(perception, PersistentPerceptionErrorModel):
        raise UsageError(
            f"the likelihood ratio is unknown: the errors of {type(perception).__name__} last over steps",
            "set its persistence to 0, or give a proposal of the noise: "
            "{gaussian: {mean: ..., std: ...}}, or an object with sample(rng, n) and log_ratio(noise)",
        )


def check_block(block: Mapping[str, Any]) -> Any:
    """The checked options of a perception block ``{"plugin": name, ...}``; builds nothing.

    Raises:
        UsageError: The options do not fit.
        PluginError: Nobody provides the plugin.
    """
    return _component(block)[1]


def _component(block: Mapping[str, Any]) -> tuple[Any, Any]:
    from pydantic import ValidationError

    from avrare.plugin.registry import default_registry

    options = {key: value for key, value in block.items() if key != "plugin"}
    component = default_registry().require("perception", str(block.get("plugin")))
    model = component.load_config()
    try:
        return component, model(**options)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        unknown = first["type"] == "extra_forbidden"
        raise UsageError(
            f"proposal {block['plugin']!r}: {key}: {'unknown key' if unknown else first['msg']}",
            did_you_mean(key, model.model_fields) if unknown else None,
        ) from None


def _built(block: Mapping[str, Any], loop: ClosedLoop) -> Any:
    component, config = _component(block)
    scene = getattr(loop.simulator, "scene", None)
    try:
        built = component.load_factory()(config, scene)
    except ImportError as error:
        raise PluginError(f"perception {component.name!r} cannot be loaded: {error}") from error
    _check_memoryless(built)
    if not hasattr(built, "log_prob"):
        raise UsageError(f"the proposal {component.name!r} has no log_prob: it cannot be weighed")
    return built
