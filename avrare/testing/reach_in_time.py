"""Reaching a goal in time: prefix robustness rises, so that splitting needs a score of its own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import Floats
from avrare.testing.gaussian_chain import Chain, survival
from avrare.testing.reference_problem import ReferenceProblem
from avrare.testing.walk_problems import Linear


@dataclass(frozen=True)
class Lag:
    """Score: the distance of x behind its mean course."""

    drift: float

    def __call__(self, signals: dict[str, Any], t: int) -> Floats:
        """Return the score (N,) at step ``t``."""
        return np.asarray(self.drift * t - signals["x"][:, t])


def reach(goal: float, steps: int = 40, drift: float = 0.1, scale: float = 0.2) -> ReferenceProblem:
    """Return a drifting walk that must reach ``goal`` at some t = 1..steps; it fails where it never does."""
    if steps < 1:
        raise UsageError("reach needs steps >= 1")
    chain = Chain(drift=drift, scale=scale)
    return ReferenceProblem(
        id=f"reach(goal={goal:g}, steps={steps}, drift={drift:g}, scale={scale:g})",
        family="reach",
        text=f"x += {drift:g} + {scale:g} w from 0; fails where it stays below {goal:g} for {steps} steps",
        system=Linear(chain),
        formula=f"eventually[1:{steps}] (x >= {goal})",
        steps=steps,
        relation="<0",
        exact=partial(survival, chain, goal, steps),
        score=Lag(drift),
    )
