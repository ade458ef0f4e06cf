"""Simple controllers that act on the observation of a simulator without a road."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from avrare.base.errors import UsageError
from avrare.protocols import Controller, Floats
from avrare_gymnasium.config import ConstantConfig, FeedbackConfig


def build_feedback(config: FeedbackConfig, scene: object | None = None) -> Feedback:
    """Build the controller of a scenario."""
    return Feedback(config.gain, config.reference, config.offset)


def build_constant(config: ConstantConfig, scene: object | None = None) -> Constant:
    """Build the controller of a scenario."""
    return Constant(config.action)


class Feedback(Controller):
    """Linear feedback: u = offset - gain (observation - reference).

    Args:
        gain: Matrix (m, d).
        reference: d numbers; None for 0.
        offset: m numbers; None for 0.
    """

    horizon = 0

    def __init__(
        self, gain: ArrayLike, reference: ArrayLike | None = None, offset: ArrayLike | None = None
    ) -> None:
        self.gain = np.asarray(gain, dtype=np.float64)
        self.reference = np.zeros(self.gain.shape[1]) if reference is None else np.asarray(reference)
        self.offset = np.zeros(self.gain.shape[0]) if offset is None else np.asarray(offset)

    def start(self, n: int) -> None:
        """Return no memory."""

    def act(self, memory: None, ego: Floats, prediction: object | None = None) -> tuple[Floats, None]:
        """Return commands (N, m) from observations (N, d).

        Raises:
            UsageError: The observation does not have d numbers.
        """
        if _check_observation(ego, "gym_feedback").shape[1] != self.gain.shape[1]:
            raise UsageError(
                f"the gain has {self.gain.shape[1]} columns, but the observation has {ego.shape[1]} numbers",
                "give the gain one column per entry of the observation",
            )
        # No BLAS: a row must not depend on its neighbours.
        return self.offset - np.einsum("nd,md->nm", ego - self.reference, self.gain), None


class Constant(Controller):
    """Controller with the same action at every step.

    Args:
        action: Integer action, or entries of a box.
    """

    horizon = 0

    def __init__(self, action: int | tuple[float, ...]) -> None:
        self.action: NDArray[Any] = np.asarray(action)

    def start(self, n: int) -> None:
        """Return no memory."""

    def act(self, memory: None, ego: object, prediction: object | None = None) -> tuple[NDArray[Any], None]:
        """Return the actions (N,) or (N, m).

        Raises:
            UsageError: The simulator has no observations (N, d).
        """
        return np.repeat(self.action[None], len(_check_observation(ego, "gym_constant")), axis=0), None


def _check_observation(ego: object, name: str) -> Floats:
    if not isinstance(ego, np.ndarray) or ego.ndim != 2:
        raise UsageError(
            f"the controller {name} needs observations (N, d), the simulator returns {type(ego).__name__}",
            "use it with gymnasium and other simulators based on avrare.worlds",
        )
    return ego
