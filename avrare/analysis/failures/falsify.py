"""Falsification: search for a failure, then for the most likely one.

The first search is subset simulation (Au and Beck, 2001) without its estimate: each round keeps the upper
quarter of the particles and moves copies of it by preconditioned Crank-Nicolson steps, x' = sqrt(1 - b^2) x +
b z, which keep the noise standard normal, for several b from large to small. A move that falls below the
score of that quarter is rejected.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from avrare.analysis.failures.tape_evaluator import ProgressCallback, TapeEvaluator
from avrare.analysis.failures.tape_reduction import find_design_point
from avrare.base.errors import UsageError
from avrare.base.records import Answer, Records
from avrare.protocols import Floats
from avrare.rollout.loaded_scenario import ScenarioProblem, open_problem
from avrare.rollout.noise import NoiseSource
from avrare.rollout.noise_words import describe_tape
from avrare.rollout.problem import Problem

BUDGET = 4000
"""Default number of rollouts of one search."""

CAUTION = (
    "caution: beta is only the distance of one failure from the rollout without noise. exp(-beta^2/2) "
    "neither estimates nor bounds the failure probability here: use `avrare run`"
)

_PARTICLES = 64


@dataclass(frozen=True, repr=False)
class FalsificationResult(Answer):
    """Result of a search for failures.

    Attributes:
        noise: (steps + 1, noise_size) of the most likely failure found, or None.
        norm: Norm of ``noise``; inf if there is none.
        first_norm: Norm of the first failure found; inf if there is none.
        first_rollouts: Rollouts until the first failure, or all of them.
        rollouts: Rollouts in total.
        errors: Number of rollouts with an error.
        finished: The search from every start ended within the budget.
        specification: Name of the specification.
        description: The noise in words; empty if there is none.
    """

    noise: Floats | None
    norm: float
    first_norm: float
    first_rollouts: int
    rollouts: int
    errors: int
    finished: bool
    specification: str
    description: str

    def table(self) -> Records:
        """Return one row, with NaN where no failure was found."""
        row = {
            "specification": self.specification,
            "beta": self.norm,
            "first_norm": self.first_norm,
            "first_rollouts": self.first_rollouts,
            "rollouts": self.rollouts,
            "errors": self.errors,
            "finished": self.finished,
            "description": self.description,
        }
        return Records([row])

    def lines(self) -> list[str]:
        """Describe the result."""
        errors = f", {self.errors} of them with errors" if self.errors else ""
        cost = f"{self.rollouts} rollouts{errors}"
        if self.noise is None:
            return [f"no failure found in {cost}; this does not prove that there is none"]
        if self.norm == 0.0:
            return [f"it fails without any noise: {self.description}", "beta = 0", CAUTION]
        more = (
            "" if self.finished else "; the budget ended the search, a larger one may find a likelier failure"
        )
        return [
            f"first failure after {self.first_rollouts} rollouts, norm {self.first_norm:.3g}",
            f"most likely failure found: norm {self.norm:.3g} ({cost}{more})",
            f"cause: {self.description}",
            f"beta = {self.norm:.3g}",
            CAUTION,
        ]


def falsify(
    subject: Problem | str | os.PathLike[str],
    specification: str | None = None,
    *,
    overrides: Sequence[str] = (),
    seed: int | None = None,
    budget: int = BUDGET,
    progress: ProgressCallback | None = None,
    safe: bool = False,
) -> FalsificationResult:
    """Search for a failure of a specification, and then for the one with the smallest norm.

    Neither search is an estimate: the result says nothing about probabilities, and a smaller failure may
    exist.

    Args:
        subject: Scenario file, or a problem.
        specification: Name; None: the only one.
        overrides: Settings of the file, as for ``--set``.
        seed: Seed of the search, for which it finds the same failure again; None: the scenario's, 0 for a
            problem without one.
        budget: Largest number of rollouts.
        progress: Called after each chunk of rollouts.
        safe: As for ``avrare.load``.

    Raises:
        UsageError: There are several specifications and none is named, or none has the name.
    """
    if not isinstance(budget, (int, np.integer)) or budget < 1:
        raise UsageError(f"budget must be a number of rollouts of at least 1, not {budget!r}", "such as 600")
    problem = open_problem(subject, specification, overrides, safe)
    if seed is None:
        seed = problem.scenario.definition.seed if isinstance(problem, ScenarioProblem) else 0
    evaluate = TapeEvaluator(problem, budget, progress)
    evaluate.activity = "running without noise"
    zeros = np.zeros(evaluate.shape)
    if evaluate([zeros]).fails.any():
        return _make_result(problem, evaluate, [zeros], 1, True)
    starts = find_failures(evaluate, seed)[:2]  # the failures of the smallest norm
    first_rollouts = evaluate.rollouts
    if not starts:
        return _make_result(problem, evaluate, [], first_rollouts, False)
    tapes, finished = [starts[0]], True
    for k, start in enumerate(starts):
        evaluate.budget = evaluate.rollouts + (budget - evaluate.rollouts) // (len(starts) - k)
        if evaluate.remaining:
            tapes.append(find_design_point(evaluate, start, seed + k))
        finished &= evaluate.remaining > 0
    return _make_result(problem, evaluate, tapes, first_rollouts, finished)


def _make_result(
    problem: Problem, evaluate: TapeEvaluator, tapes: list[Floats], first_rollouts: int, finished: bool
) -> FalsificationResult:
    norms = [float(np.linalg.norm(tape)) for tape in tapes]
    best = tapes[int(np.argmin(norms))] if tapes else None
    return FalsificationResult(
        noise=best,
        norm=min(norms, default=np.inf),
        first_norm=norms[0] if norms else np.inf,
        first_rollouts=first_rollouts,
        rollouts=evaluate.rollouts,
        errors=evaluate.errors,
        finished=finished,
        specification=problem.names[0],
        description="" if best is None else describe_tape(problem, best),
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
    step_sizes = (0.9, 0.6, 0.4, 0.25, 0.15, 0.08)
    size = np.array(step_sizes)[np.arange(_PARTICLES) % len(step_sizes)][:, None, None]
    stage = 0
    while evaluate.remaining and not fails.any():
        stage += 1
        # 1. Resample from the upper quarter.
        order = np.argsort(-scores, kind="stable")
        parents = order[np.arange(_PARTICLES) % (_PARTICLES // 4)]
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
