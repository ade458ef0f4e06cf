"""Responding in time: whenever x comes to the trigger, it must be clear again within k steps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from avrare.errors import UsageError
from avrare.protocols import Floats
from avrare.testing.chain import Chain
from avrare.testing.problem import ReferenceProblem
from avrare.testing.walks import Linear, unit_scale

_CLEAR = 0.0


@dataclass(frozen=True)
class Waiting:
    """Score: nearness to the trigger, then 1 and the share of the time limit that has passed.

    Attributes:
        trigger: x that starts the clock.
        within: Steps allowed.
        last: Last step at which a trigger counts.
    """

    trigger: float
    within: int
    last: int

    def __call__(self, signals: dict[str, Any], t: int) -> Floats:
        """(N,) at step ``t``; 2 at the moment of failure."""
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
    """An Ornstein-Uhlenbeck walk at ``trigger`` must be at 0 or below within so many steps."""
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
    """Integration on the chain of x and the age of the oldest unanswered trigger.

    ``idle`` is the density of x without one; column j of ``waiting`` that of x > 0 with one of age j.
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
