"""Finding one failure, however rare: particles climb the score of the problem.

Each round keeps the upper quarter and moves copies of it a little, as preconditioned Crank-Nicolson does
(x' = sqrt(1 - b^2) x + b z, which keeps the noise standard normal), in steps from large to small. A move that
falls below the quarter's score is undone. This is subset simulation (Au and Beck 2001) without its estimate.
"""

from __future__ import annotations

import numpy as np

from avrare.failures.trials import Trials
from avrare.protocols import Floats
from avrare.rollout.noise import NoiseSource

PARTICLES = 64
_KEPT = 0.25
_STEPS = (0.9, 0.6, 0.4, 0.25, 0.15, 0.08)


def climb(trials: Trials, seed: int, particles: int = PARTICLES) -> list[Floats]:
    """Failing tapes (steps + 1, noise_size), smallest norm first; empty where the budget did not reach.

    Args:
        trials: Runs tapes and holds the budget.
        seed: Of the random numbers.
        particles: That climb together.
    """
    trials.doing = "looking for a failure"
    noise, step = NoiseSource(seed, trials.shape[1]), np.arange(trials.shape[0])
    particle = np.arange(particles)[:, None]
    tapes = noise.normals(0, 0, particle, step)
    tried = trials(tapes, scored=True)
    scores, fails = _filled(tried.score, particles), tried.fails
    size = np.array(_STEPS)[np.arange(particles) % len(_STEPS)][:, None, None]
    stage = 0
    while trials.left and not fails.any():
        stage += 1
        order = np.argsort(-scores, kind="stable")
        parents = order[np.arange(particles) % max(int(_KEPT * particles), 1)]
        level = scores[parents].min()
        moved = np.sqrt(1.0 - size**2) * tapes[parents] + size * noise.normals(0, stage, particle, step)
        tried = trials(moved, scored=True)
        fails, found = tried.fails, _filled(tried.score, particles)
        if fails.any():
            tapes = moved
            break
        up = (found >= level) & np.isfinite(found)
        tapes = np.where(up[:, None, None], moved, tapes[parents])
        scores = np.where(up, found, scores[parents])
    failing = [tapes[k] for k in np.flatnonzero(fails)]
    return sorted(failing, key=lambda tape: float(np.linalg.norm(tape)))


def _filled(scores: Floats, count: int) -> Floats:
    """Scores of all particles, -inf of those that the budget did not reach."""
    return np.concatenate([scores, np.full(count - len(scores), -np.inf)])
