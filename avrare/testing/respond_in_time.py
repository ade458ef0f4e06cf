"""Responding in time: whenever x reaches the trigger, it must be clear of it within k steps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import Floats
from avrare.testing.gaussian_chain import Chain
from avrare.testing.reference_problem import ReferenceProblem
from avrare.testing.walk_problems import Linear, unit_scale

_CLEAR = 0.0


@dataclass(frozen=True)
class Waiting:
    """Score: nearness to the trigger, then 1 and the share of the time limit that has passed.

    Attributes:
        trigger: Value of x that starts the time limit.
        within: Time limit in steps.
        last: Last step at which a trigger counts.
    """

    trigger: float
    within: int
    last: int

    def __call__(self, signals: dict[str, Any], t: int) -> Floats:
        """Return the score (N,) at step ``t``; 2 at failure."""
        x, times = signals["x"], np.arange(t + 1)
        cleared = np.where(x <= _CLEAR, times, -1).max(axis=1, keepdims=True)
        pending = (x >= self.trigger) & (times > cleared) & (times <= self.last)
        elapsed = t - pending.argmax(axis=1)
        waiting = 1.0 + np.minimum(elapsed / self.within, 1.0)
        near = np.minimum(0.999, x[:, t] / self.trigger) if t <= self.last else np.full(len(x), -np.inf)
        return np.asarray(np.where(pending.any(axis=1), waiting, near))


def response(
    within: int, steps: int = 100, trigger: float = 2.0, decay: float = 0.9, start: float = 0.5
) -> ReferenceProblem:
    """Return an Ornstein-Uhlenbeck walk that must fall to 0 within so many steps of reaching ``trigger``."""
    if not (1 <= within < steps and max(start, _CLEAR) < trigger):
        raise UsageError("response needs 1 <= within < steps, and a trigger above 0 and the start")
    chain = Chain(decay, scale=unit_scale(decay), start=start)
    last = steps - within
    return ReferenceProblem(
        id=f"response(within={within}, steps={steps}, trigger={trigger:g}, decay={decay:g}, start={start:g})",
        family="response",
        text=f"x = {decay:g} x + sqrt(1 - {decay:g}^2) w from {start:g} for {steps} steps; fails where it "
        f"comes to {trigger:g} by step {last} and then stays above 0 for {within} steps",
        system=Linear(chain),
        formula=f"always[0:{last}] ((x >= {trigger}) -> eventually[0:{within}] (x <= {_CLEAR}))",
        steps=steps,
        relation="<0",
        exact=partial(_unanswered, chain, trigger, within, steps),
        score=Waiting(trigger, within, last),
    )


def _unanswered(chain: Chain, trigger: float, within: int, steps: int) -> float:
    """Integrate over x and the age of the oldest unanswered trigger.

    ``idle`` is the density of x without a trigger, column j of ``waiting`` that of x > 0 with one of age j.
    """
    nodes, weights = chain.grid(steps, [_CLEAR, trigger], above=True)
    kernel = chain.density(nodes[:, None], nodes) * weights
    lasting = chain.above(_CLEAR, nodes) * weights
    positive, triggered = nodes > _CLEAR, nodes >= trigger
    idle, waiting, total = chain.density(nodes, chain.start), np.zeros((len(nodes), within)), 0.0
    for t in range(1, steps):
        fresh = triggered & (t <= steps - within)
        waiting[:, 0] = np.where(fresh, idle, 0.0)
        total += float(lasting @ waiting[:, -1])
        moved = kernel @ waiting
        idle = kernel @ np.where(fresh, 0.0, idle) + np.where(positive, 0.0, moved.sum(axis=1))
        waiting[:, 1:] = np.where(positive[:, None], moved[:, :-1], 0.0)
    return total
