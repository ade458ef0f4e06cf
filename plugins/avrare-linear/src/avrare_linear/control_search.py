"""Search for controls that satisfy a formula, as a first trajectory.

Controls are drawn like noise, and satisfying the formula is the rare event that slice sampling finds
(stl-ess, section V, note c).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from avrare.base.errors import UsageError
from avrare.estimation.loop.loop import run
from avrare.estimation.plan.plan import Settings
from avrare.logic.formula import Formula, stl
from avrare.protocols import Floats
from avrare.rollout.executors.serial import SerialExecutor
from avrare.rollout.problem import Problem
from avrare_linear.estimator import LinearLevels
from avrare_linear.estimator_config import LinearEssConfig
from avrare_linear.system import LinearSystem


def find_controls(
    system: LinearSystem, formula: Formula, steps: int, bandwidth: float, *, chains: int = 20, seed: int = 0
) -> Floats:
    """Find controls (steps, m) with which a linear system without noise satisfies a formula.

    Independent normal controls take the place of the system's noise and feedback; nested levels lead to those
    that satisfy the formula, however rare they are. The most robust of them are returned, as ``feedforward``
    of a first trajectory. Only the bandwidth keeps them small.

    Args:
        system: System with inputs.
        formula: Aim of the trajectory; predicates affine in the signals.
        steps: T.
        bandwidth: Standard deviation of every control.
        chains: Chains of the search.
        seed: Seed of its noise.

    Raises:
        UsageError: The system has no inputs, or more than states; or no controls are found.
    """
    states, inputs = len(system.names[0]), len(system.names[1])
    if not 0 < inputs <= states or bandwidth <= 0.0:
        raise UsageError("controls need a system with inputs, no more than states, and a positive bandwidth")
    process = np.zeros((len(system.B), states, states))
    process[:, :, :inputs] = bandwidth * system.B
    driven = _open_loop(
        replace(
            system,
            process=process,
            spread=np.zeros_like(system.spread),
            measurement=np.zeros_like(system.measurement),
        )
    )
    failing = stl(f"not ({formula})", dt=formula.dt, warn=False)
    levels = LinearLevels(LinearEssConfig(chains=chains, runs=1, second_pass=False))
    [result] = run(Problem(driven, failing, steps), levels, SerialExecutor(), Settings(seed))
    if not len(result.failures.robustness):
        raise UsageError("no controls satisfy the formula", "raise the bandwidth or the chains")
    best = int(np.argmin(result.failures.robustness))
    return bandwidth * result.failures.noise[best, 1:, :inputs]


def _open_loop(system: LinearSystem) -> LinearSystem:
    return replace(
        system, gain=np.zeros_like(system.gain), observer=None, feedforward=np.zeros_like(system.feedforward)
    )
