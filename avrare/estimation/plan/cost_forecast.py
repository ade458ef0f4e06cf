"""Forecast of an estimate's whole cost while it runs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal


@dataclass(frozen=True)
class CostForecast:
    """Whole cost of an estimate, as far as it is certain before its end.

    Attributes:
        kind: Unit of the amounts: "rollouts", "steps" (simulated ones) or "seconds".
        least: Amount that the estimate is expected to take at least.
        most: Amount at most; infinite where nothing limits it yet.
        given: Evidence for the amounts, such as "p 0.01 .. 1e-06"; empty where they are firm.
    """

    kind: Literal["rollouts", "steps", "seconds"]
    least: float
    most: float
    given: str = ""

    def after(self, rollouts: int, steps: int) -> CostForecast:
        """Return the forecast of an estimate of which parts at this cost are done."""
        done = {"rollouts": rollouts, "steps": steps, "seconds": 0}[self.kind]
        return replace(self, least=self.least + done, most=self.most + done)
