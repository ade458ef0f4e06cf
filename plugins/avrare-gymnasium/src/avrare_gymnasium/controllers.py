"""Plain controllers: they act on the observation of a simulator that is no road."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.errors import UsageError
from avrare.protocols import Floats
from avrare_gymnasium.controller_config import ConstantConfig, FeedbackConfig


def build_feedback(config: FeedbackConfig, scene: object | None = None) -> Feedback:
    """The controller of a scenario."""
    return Feedback(config.gain, config.reference, config.offset)


def build_constant(config: ConstantConfig, scene: object | None = None) -> Constant:
    """The controller of a scenario."""
    return Constant(config.action)


class Feedback:
    """u = offset - gain (observation - reference).

    Args:
        gain: m x d.
        reference: d numbers; None: 0.
        offset: m numbers; None: 0.
    """

    horizon = 0

    def __init__(self, gain: Any, reference: Any = None, offset: Any = None) -> None:
        self.gain = np.asarray(gain, dtype=np.float64)
        self.reference = np.zeros(self.gain.shape[1]) if reference is None else np.asarray(reference)
        self.offset = np.zeros(self.gain.shape[0]) if offset is None else np.asarray(offset)

    def start(self, n: int) -> None:
        """It remembers nothing."""

    def act(self, memory: None, ego: Floats, prediction: object | None = None) -> tuple[Floats, None]:
        """Commands (N, m) from observations (N, d).

        Raises:
            UsageError: The observation is none of d numbers.
        """
        if _seen(ego, "gym_feedback").shape[1] != self.gain.shape[1]:
            raise UsageError(
                f"the gain has {self.gain.shape[1]} columns, but there are {ego.shape[1]} numbers to see",
                "give the gain one column for each entry of the observation",
            )
        # No BLAS: a row must not depend on its neighbours.
        return self.offset - np.einsum("nd,md->nm", ego - self.reference, self.gain), None


class Constant:
    """The same action always.

    Args:
        action: An integer, or the entries of a box.
    """

    horizon = 0

    def __init__(self, action: int | tuple[float, ...]) -> None:
        self.action: NDArray[Any] = np.asarray(action)

    def start(self, n: int) -> None:
        """It remembers nothing."""

    def act(self, memory: None, ego: Any, prediction: object | None = None) -> tuple[NDArray[Any], None]:
        """The action (N,) or (N, m).

        Raises:
            UsageError: The simulator is a road with vehicles.
        """
        return np.repeat(self.action[None], len(_seen(ego, "gym_constant")), axis=0), None


def _seen(ego: Any, name: str) -> Floats:
    """The observations (N, d)."""
    if not isinstance(ego, np.ndarray) or ego.ndim != 2:
        raise UsageError(
            f"the controller {name} acts on rows of numbers, and this simulator shows a {type(ego).__name__}",
            "it is for the simulator gymnasium and others made by avrare.worlds",
        )
    return ego
