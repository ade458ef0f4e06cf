"""Problem for importance sampling over perception error models.

Persistent errors are refused: the density of an observation would have to be the one given all earlier
observations, and a miss bounds the latent error only from one side, which leaves an integral over its paths.

Density ratios of nearby models along given rollouts reweigh failures for these models; their derivatives are
the score function of a model's parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from avrare.base import batch
from avrare.base.errors import UsageError
from avrare.plugin.registry import default_registry
from avrare.protocols import Floats, PerceptionErrorModel, adapt, overrides
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request
from avrare.scenario.schema import Block
from avrare.scenario.validation import check_options
from avrare.stack.builder import build_block
from avrare.stack.burn_in import BurnIn
from avrare.stack.closed_loop import ClosedLoop, WeightedLoop


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

    def __init__(self, target: Problem, proposal: object = None, needs: str = "log_prob") -> None:
        loop = _check_loop(target, needs)
        self.target, self.proposal, self.needs = target, proposal, needs
        built = None if proposal is None else _build_proposal(proposal, loop)
        monitors = dict(zip(target.names, target.specifications, strict=True))
        # The target's monitors have its score already.
        super().__init__(
            WeightedLoop(loop, built),
            monitors,
            target.steps,
            "robustness",
            chunk=target.named_chunk,
            rollout_timeout=target.rollout_timeout,
        )

    def __reduce__(self) -> tuple[object, ...]:
        return WeightedProblem, (self.target, self.proposal, self.needs)


def _check_loop(target: Problem, needs: str) -> ClosedLoop:
    loop = target.system
    if not isinstance(loop, ClosedLoop):
        raise UsageError(
            f"a perception model as proposal needs a closed loop, but the system is a {type(loop).__name__}",
            "give a proposal of the noise: an object with sample(rng, n) and log_ratio(noise)",
        )
    model = loop.perception
    if model is not None:
        _check_memoryless(model)
    if model is None or not _has_density(model, needs):
        perception = f"{type(model).__name__}, which has no {needs}" if model else "no perception model"
        raise UsageError(
            f"the likelihood ratio is unknown: the closed loop has {perception}",
            "choose a perception model with log_prob(world, observation), or a proposal of the noise",
        )
    return loop


def _has_density(model: PerceptionErrorModel, needs: str = "log_prob") -> bool:
    return hasattr(model, needs) and (needs != "log_prob" or overrides(model, PerceptionErrorModel.log_prob))


def _check_memoryless(perception: PerceptionErrorModel) -> None:
    if overrides(perception, PerceptionErrorModel.follow):
        raise UsageError(
            f"the likelihood ratio is unknown: the errors of {type(perception).__name__} last over steps",
            "set its persistence to 0, or give a proposal of the noise: "
            "{name: gaussian, mean: ..., std: ...}, or an object with sample(rng, n) and log_ratio(noise)",
        )


def check_proposal(options: Mapping[str, object]) -> Block:
    """Check a perception block ``{"plugin": name, ...}`` without building anything."""
    name = str(options.get("plugin"))
    kind = "perception"
    component = default_registry().require(kind, name)
    settings = {key: value for key, value in options.items() if key != "plugin"}
    config = check_options(component.load_config(), name, settings, kind)
    row = default_registry().find(kind, name)
    return Block(name, component, config, row.distribution, row.version)


def _build_proposal(proposal: object, loop: ClosedLoop) -> PerceptionErrorModel:
    if isinstance(proposal, Mapping):
        model = build_block(check_proposal(proposal), loop.scene, PerceptionErrorModel)
    else:
        model = adapt(PerceptionErrorModel, proposal)
    _check_memoryless(model)
    if not _has_density(model):
        raise UsageError(f"the proposal {type(model).__name__} has no log_prob: it cannot be weighed")
    return model


def find_ratio_model(problem: Problem) -> PerceptionErrorModel | None:
    """Return the perception error model of a problem if it has density ratios, else None."""
    loop = problem.system
    model = loop.perception if isinstance(loop, ClosedLoop) else None
    return model if model is not None and overrides(model, PerceptionErrorModel.log_ratio) else None


def log_ratios(problem: Problem, others: list[PerceptionErrorModel], tapes: Floats) -> Floats:
    """Return (N, K) log density ratios of K nearby perception error models along rollouts of N tapes.

    They are NaN for a model that may give, somewhere along a rollout, an observation that the problem's
    own cannot.

    Args:
        problem: Problem whose system is a closed loop.
        others: The models, of the kind of the loop's.
        tapes: (N, steps + 1, noise_size).
    """
    loop, model = problem.system, find_ratio_model(problem)
    if not isinstance(loop, ClosedLoop) or model is None:
        raise UsageError("density ratios need a closed loop with a perception error model")
    total = np.zeros((len(tapes), len(others)))
    for at in range(0, len(tapes), problem.chunk):
        part = tapes[at : at + problem.chunk]
        request = replace(Request.replay(part, keep_carries=True), stop_early=True)
        outcome = problem.simulate(NoiseSource(0, problem.noise_size), request, scored=False)
        total[at : at + len(part)] = _sum_ratios(
            model, others, part[..., loop.world_noise :], outcome.carries, loop.burn_in
        )
    return total


def _sum_ratios(
    model: PerceptionErrorModel,
    others: list[PerceptionErrorModel],
    tapes: Floats,
    carries: Any,
    burn_in: BurnIn | None,
) -> Floats:
    lasts = overrides(model, PerceptionErrorModel.follow)
    memories = [other.start(tapes[:, 0]) if lasts else None for other in others]
    total, before = np.zeros((len(tapes), len(others))), None
    rows_before = np.arange(len(tapes))
    for step, rows, carry in carries:
        state = carry.system
        if step > 0:
            places = np.searchsorted(rows_before, rows)
            memories = [batch.take(memory, places) if lasts else None for memory in memories]
            memory = batch.take(before, places) if lasts else None
            noise = tapes[rows, step]
            for k, other in enumerate(others):
                ratio, memories[k] = model.log_ratio(state.world, noise, memory, other, memories[k])
                total[rows, k] += ratio
        elif burn_in is not None:
            memory = model.start(tapes[rows, 0]) if lasts else None
            for world, noise in burn_in.worlds(state.world, tapes[rows, 0]):
                for k, other in enumerate(others):
                    ratio, memories[k] = model.log_ratio(world, noise, memory, other, memories[k])
                    total[rows, k] += ratio
                memory = model.follow(world, noise, memory)[1]
        before, rows_before = state.latent, rows
    return total
