"""The specification: a sum over time has a limit, which temporal logic has no words for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.errors import UsageError
from avrare.protocols import Floats, Signals, Verdict
from avrare_example.config import SpillageConfig


@dataclass(frozen=True)
class SpillageState:
    """The monitor of N particles.

    Attributes:
        total: (N,) water spilled so far [m^3].
    """

    total: Floats


class Spillage:
    """Robustness is what may still be spilled [m^3]; it never rises, so each prefix has that of its end.

    Args:
        config: The options.
    """

    def __init__(self, config: SpillageConfig) -> None:
        self.limit = config.limit

    def start(self, n: int) -> SpillageState:
        """Monitor state before sample 0."""
        return SpillageState(np.zeros(n))

    def update(self, state: SpillageState, signals: Signals) -> tuple[SpillageState, Verdict]:
        """Monitor state and verdict after one more sample of the signal ``spilled``.

        Raises:
            UsageError: There is no such signal.
        """
        if "spilled" not in signals:
            raise UsageError("spillage needs the signal 'spilled'", "take the simulator tank")
        total = np.asarray(state.total + signals["spilled"])
        robustness = self.limit - total
        return SpillageState(total), Verdict(robustness, robustness < 0.0, total)


def build(config: SpillageConfig, scene: object | None = None) -> Spillage:
    """The monitor of a scenario."""
    return Spillage(config)
