"""Reaching in time: a formula whose prefix robustness rises, so that levels need a score of their own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from avrare.errors import UsageError
from avrare.protocols import Floats
from avrare.testing.chain import Chain, survival
from avrare.testing.problem import ReferenceProblem
from avrare.testing.walks import Linear


@dataclass(frozen=True)
class Lag:
    """Score: how far x is behind its mean course."""

    drift: float

    def __call__(self, signals: dict[str, Any], t: int) -> Floats:
        """(N,) at step ``t``."""
        return np.asarray(self.drift * t - signals["x"][:, t])


def reach(goal: float, steps: int = 40, drift: float = 0.1, scale: float = 0.2) -> ReferenceProblem:
    """A drifting walk that must come to ``goal`` at some t = 1..steps and never does."""
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
