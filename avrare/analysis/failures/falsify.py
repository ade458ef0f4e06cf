"""Falsification: search for a failure, then for the most likely one.

The first search is subset simulation (Au and Beck, 2001) without its estimate: each round keeps the upper
quarter of the particles and moves copies of it by preconditioned Crank-Nicolson steps, x' = sqrt(1 - b^2) x +
b z, which keep the noise standard normal, for several b from large to small. A move that falls below the
score of that quarter is rejected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.analysis.failures.tape_evaluator import ProgressCallback, TapeEvaluator
from avrare.analysis.failures.tape_reduction import find_design_point
from avrare.protocols import Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem

BUDGET = 4000
"""Default number of rollouts of one search."""

_PARTICLES = 64
_SURVIVING = 0.25
_STEP_SIZES = (0.9, 0.6, 0.4, 0.25, 0.15, 0.08)
_STARTS = 2
"""Number of failures, those of the smallest norm, from which the design point is searched."""


@dataclass(frozen=True)
class FalsificationResult:
    """Result of a search for failures.

    Attributes:
        noise: (steps + 1, noise_size) of the most likely failure found, or None.
        norm: Norm of ``noise``; inf if there is none.
        first_norm: Norm of the first failure found; inf if there is none.
        first_rollouts: Rollouts until the first failure, or all of them.
        rollouts: Rollouts in total.
        errors: Number of rollouts with an error.
        finished: The search from every start ended within the budget.
    """

    noise: Floats | None
    norm: float
    first_norm: float
    first_rollouts: int
    rollouts: int
    errors: int
    finished: bool


def falsify(
    problem: Problem, seed: int = 0, budget: int = BUDGET, progress: ProgressCallback | None = None
) -> FalsificationResult:
    """Search for a failure of the first specification, and then for the one with the smallest norm.

    Neither search is an estimate: the result says nothing about probabilities, and a smaller failure may
    exist.

    Args:
        problem: Problem to falsify.
        seed: Seed of the search; the same seed finds the same failure.
        budget: Largest number of rollouts.
        progress: Called after each chunk of rollouts.
    """
    evaluate = TapeEvaluator(problem, budget, progress)
    evaluate.activity = "running without noise"
    zeros = np.zeros(evaluate.shape)
    if evaluate([zeros]).fails.any():
        return FalsificationResult(zeros, 0.0, 0.0, 1, 1, evaluate.errors, True)
    starts = find_failures(evaluate, seed)[:_STARTS]
    first_rollouts = evaluate.rollouts
    if not starts:
        return FalsificationResult(
            None, np.inf, np.inf, first_rollouts, first_rollouts, evaluate.errors, False
        )
    found, finished = [starts[0]], True
    for k, start in enumerate(starts):
        evaluate.budget = evaluate.rollouts + (budget - evaluate.rollouts) // (len(starts) - k)
        if evaluate.remaining:
            found.append(find_design_point(evaluate, start, seed + k))
        finished &= evaluate.remaining > 0
    best = min(found, key=lambda tape: float(np.linalg.norm(tape)))
    norm, first_norm = float(np.linalg.norm(best)), float(np.linalg.norm(starts[0]))
    return FalsificationResult(
        best, norm, first_norm, first_rollouts, evaluate.rollouts, evaluate.errors, finished
    )


def find_failures(evaluate: TapeEvaluator, seed: int) -> list[Floats]:
    """Search for any failure, however rare, by particles that climb the score of the problem.

    Returns failing tapes (steps + 1, noise_size), smallest norm first; none if the budget ran out.
    """
    evaluate.activity = "looking for a failure"
    noise, step = NoiseSource(seed, evaluate.shape[1]), np.arange(evaluate.shape[0])
    particle = np.arange(_PARTICLES)[:, None]
    tapes = noise.normals(0, 0, particle, step)
    outcome = evaluate(tapes, scored=True)
    scores, fails = _pad(outcome.score), outcome.fails
    size = np.array(_STEP_SIZES)[np.arange(_PARTICLES) % len(_STEP_SIZES)][:, None, None]
    stage = 0
    while evaluate.remaining and not fails.any():
        stage += 1
        # 1. Resample from the upper quarter.
        order = np.argsort(-scores, kind="stable")
        parents = order[np.arange(_PARTICLES) % max(int(_SURVIVING * _PARTICLES), 1)]
        level = scores[parents].min()
        # 2. Move every copy.
        moved = np.sqrt(1.0 - size**2) * tapes[parents] + size * noise.normals(0, stage, particle, step)
        outcome = evaluate(moved, scored=True)
        fails, moved_scores = outcome.fails, _pad(outcome.score)
        if fails.any():
            tapes = moved
            break
        # 3. Reject moves below the level.
        accepted = (moved_scores >= level) & np.isfinite(moved_scores)
        tapes = np.where(accepted[:, None, None], moved, tapes[parents])
        scores = np.where(accepted, moved_scores, scores[parents])
    failing = [tapes[k] for k in np.flatnonzero(fails)]
    return sorted(failing, key=lambda tape: float(np.linalg.norm(tape)))


def _pad(scores: Floats) -> Floats:
    # The budget did not reach the particles without a score.
    return np.concatenate([scores, np.full(_PARTICLES - len(scores), -np.inf)])
