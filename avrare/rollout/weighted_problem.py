"""Problem for importance sampling over perception error models.

Persistent errors are refused: the density of an observation would have to be the one given all earlier
observations, and a miss bounds the latent error only from one side, which leaves an integral over its paths.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from avrare.base.errors import UsageError
from avrare.plugin.registry import default_registry
from avrare.protocols import (
    HasDensity,
    PerceptionErrorModel,
    PersistentPerceptionErrorModel,
    find_ability,
    find_scene,
)
from avrare.rollout.problem import Problem
from avrare.scenario.schema import Block
from avrare.scenario.validation import check_options
from avrare.stack.builder import build_block
from avrare.stack.closed_loop import ClosedLoop, WeightedLoop

_KIND = "perception"


class WeightedProblem(Problem):
    """Problem whose closed loop can be drawn from other perception error models.

    It is pickled as its target (a problem from a scenario: as its recipe) and the proposal.

    Args:
        target: Problem whose system is a ``ClosedLoop`` with a perception error model that has ``log_prob``.
        proposal: Perception error model; or a block ``{"plugin": name, ...}`` that is built for the target's
            scene; or None where each request brings its own.
        needs: Member that the target's perception error model must have.

    Raises:
        UsageError: The target has no such perception error model, or the block does not fit.
        PluginError: No plugin provides the block.
    """

    def __init__(self, target: Problem, proposal: Any = None, needs: str = "log_prob") -> None:
        loop = _check_loop(target, needs)
        self.target, self.proposal, self.needs = target, proposal, needs
        built = _build_proposal(proposal, loop) if isinstance(proposal, Mapping) else proposal
        monitors = dict(zip(target.names, target.specifications, strict=True))
        _check_memoryless(built)
        # The target's monitors have its score already.
        super().__init__(
            WeightedLoop(loop, built), monitors, target.steps, "robustness", chunk=target.named_chunk
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return WeightedProblem, (self.target, self.proposal, self.needs)


def _check_loop(target: Problem, needs: str) -> ClosedLoop:
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
            "{name: gaussian, mean: ..., std: ...}, or an object with sample(rng, n) and log_ratio(noise)",
        )


def check_proposal(options: Mapping[str, Any]) -> Block:
    """Check a perception block ``{"plugin": name, ...}`` without building anything."""
    name = str(options.get("plugin"))
    component = default_registry().require(_KIND, name)
    given = {key: value for key, value in options.items() if key != "plugin"}
    config = check_options(component.load_config(), name, given, _KIND)
    row = default_registry().find(_KIND, name)
    return Block(name, component, config, row.distribution, row.version)


def _build_proposal(options: Mapping[str, Any], loop: ClosedLoop) -> PerceptionErrorModel:
    block = check_proposal(options)
    built = build_block(block, find_scene(loop.simulator), PerceptionErrorModel)
    _check_memoryless(built)
    if find_ability(built, HasDensity) is None:
        raise UsageError(f"the proposal {block.plugin!r} has no log_prob: it cannot be weighed")
    return built
