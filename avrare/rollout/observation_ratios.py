"""Density ratios of nearby perception error models for the observations along given rollouts.

They reweigh failures for other models; their derivatives are the score function of the model's parameters.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from avrare.base import batch
from avrare.base.errors import UsageError
from avrare.protocols import Floats, PerceptionErrorModel, overrides
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request
from avrare.stack.burn_in import BurnIn
from avrare.stack.closed_loop import ClosedLoop


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
