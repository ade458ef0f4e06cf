"""Specification that limits a sum over time, which signal temporal logic cannot express."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import Floats, Signals, Specification, Verdict
from avrare_example.config import SpillageConfig


@dataclass(frozen=True)
class SpillageState:
    """Monitor state of N particles.

    Attributes:
        total: (N,) volume spilled so far [m^3].
    """

    total: Floats


class Spillage(Specification):
    """Monitor whose robustness is the remaining volume [m^3].

    The remaining volume never increases, so the robustness of a prefix is that of its last sample.

    Args:
        config: Options.
    """

    def __init__(self, config: SpillageConfig) -> None:
        self.limit = config.limit

    def start(self, n: int) -> SpillageState:
        """Return the monitor state of ``n`` particles before sample 0."""
        return SpillageState(np.zeros(n))

    def update(self, state: SpillageState, signals: Signals) -> tuple[SpillageState, Verdict]:
        """Return the monitor state and the verdict after one more sample of the signal ``spilled``.

        Raises:
            UsageError: The signal does not exist.
        """
        if "spilled" not in signals:
            raise UsageError("spillage needs the signal 'spilled'", "use the simulator tank")
        total = np.asarray(state.total + signals["spilled"])
        robustness = self.limit - total
        return SpillageState(total), Verdict(robustness, robustness < 0.0, total)


def build(config: SpillageConfig, scene: object | None = None) -> Spillage:
    """Build the monitor of a scenario."""
    return Spillage(config)
