"""Density ratios of nearby perception error models for what is observed along given rollouts.

They reweigh failures for other models; their derivatives are the score function of the model's parameters.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from avrare.base import batch
from avrare.base.errors import UsageError
from avrare.protocols import Floats, PersistentPerceptionErrorModel
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request
from avrare.stack.closed_loop import ClosedLoop


class HasLogRatio(Protocol):
    """Perception error model that knows the density ratio of a nearby one for what its noise observes."""

    def log_ratio(
        self, world: Any, noise: Floats, memory: Any, other: Any, other_memory: Any
    ) -> tuple[Floats, Any]:
        """Return (N,) log ratio of ``other`` for the observation from ``noise``, and ``other``'s memory.

        It is NaN where ``other`` may observe what this model cannot: no weights of rollouts under this model
        make up for that.

        ``memory`` is that before the step, and ``other_memory`` that of the tape on which ``other`` would
        have observed the same; both are None where errors do not last.
        """


def log_ratios(problem: Problem, others: list[Any], tapes: Floats) -> Floats:
    """Return (N, K) log density ratios of K nearby perception error models along rollouts of N tapes.

    They are NaN for a model that may observe, somewhere along a rollout, what the problem's own cannot.

    Args:
        problem: Problem whose system is a closed loop.
        others: The models, of the kind of the loop's.
        tapes: (N, steps + 1, noise_size).
    """
    loop = problem.system
    if not isinstance(loop, ClosedLoop):
        raise UsageError("density ratios need a closed loop with a perception error model")
    total = np.zeros((len(tapes), len(others)))
    for at in range(0, len(tapes), problem.chunk):
        part = tapes[at : at + problem.chunk]
        request = replace(Request.replay(part, keep_carries=True), stop_early=True)
        outcome = problem.simulate(NoiseSource(0, problem.noise_size), request, scored=False)
        total[at : at + len(part)] = _sum_ratios(loop, others, part, outcome.carries)
    return total


def _sum_ratios(loop: ClosedLoop, others: list[Any], tapes: Floats, carries: Any) -> Floats:
    own, model = loop.world_noise, loop.perception
    lasts = isinstance(model, PersistentPerceptionErrorModel)
    memories = [other.start(tapes[:, 0, own:]) if lasts else None for other in others]
    total, before = np.zeros((len(tapes), len(others))), None
    rows_before = np.arange(len(tapes))
    for step, rows, carry in carries:
        state = carry.system
        if step > 0:
            kept = np.searchsorted(rows_before, rows)
            memories = [batch.take(memory, kept) if lasts else None for memory in memories]
            memory = batch.take(before, kept) if lasts else None
            noise = tapes[rows, step, own:]
            for k, other in enumerate(others):
                ratio, memories[k] = model.log_ratio(state.world, noise, memory, other, memories[k])  # type: ignore[union-attr]
                total[rows, k] += ratio
        before, rows_before = state.latent, rows
    return total
