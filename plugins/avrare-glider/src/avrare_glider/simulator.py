"""Simulator ``glider``: the glider with its feedback."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import Floats, Signals, Simulator
from avrare.rollout.request import Integers
from avrare_glider.aircraft import DT, ELEVATOR_STOPS, NAMES, RATE_LIMIT, START, Columns, advance
from avrare_glider.config import GliderConfig
from avrare_glider.feedback import gains
from avrare_glider.nominal import nominal


@dataclass(frozen=True)
class GliderState:
    """State of N gliders.

    Attributes:
        step: (N,) number of steps done.
        motion: Seven columns (N,), see ``aircraft.NAMES``.
    """

    step: Integers
    motion: Columns


def build(config: GliderConfig, scene: object | None = None) -> GliderSimulator:
    """Build the simulator of a scenario."""
    return GliderSimulator(config)


class GliderSimulator(Simulator):
    """A glider that follows the nominal flight to a wire.

    The elevator's rate is the nominal one, minus gain times error, plus noise, clipped to the servo's limit
    and the elevator's stops. After the end of the nominal flight only the noise moves it.

    Row 0 of the noise tape sets the start: its first number x, its second z. The first number of row t
    disturbs the elevator from step t - 1 to t.

    Attributes:
        dt: Step [s].
        noise_size: 2, or 1 where the start is not random.
        noise_names: Names of these numbers.
    """

    dt = DT

    def __init__(self, config: GliderConfig) -> None:
        self.noise = config.noise
        self.noise_size = 2 if config.noise.x or config.noise.z else 1
        self.noise_names = ("elevator's rate (at 0 s: start in x)", "start in z")[: self.noise_size]
        flight = nominal()
        feedback = gains(flight, config.feedback) if config.feedback is not None else 0.0 * flight.states[:-1]
        self._reference = flight.states
        self._inputs = np.append(flight.inputs, 0.0)  # the last row holds after the end
        self._gains = np.vstack([feedback, np.zeros(len(NAMES))])

    def reset(self, noise: Floats) -> GliderState:
        """Return the state at t = 0 from noise (N, noise_size)."""
        columns = [np.full(len(noise), value) for value in START]
        for i, scale in enumerate((self.noise.x, self.noise.z)[: self.noise_size]):
            columns[i] = columns[i] + scale * noise[:, i]
        return GliderState(np.zeros(len(noise), dtype=np.int64), tuple(columns))

    def step(self, world: GliderState, action: object, noise: Floats) -> GliderState:
        """Return the state one step later from noise (N, noise_size).

        Raises:
            UsageError: The scenario has a controller.
        """
        if action is not None:
            raise UsageError("glider has a controller of its own", "leave out `controller:`, use `feedback:`")
        rate = self._command(world) + self.noise.actuator * noise[:, 0]
        rate = np.clip(rate, -RATE_LIMIT, RATE_LIMIT)
        room = [(stop - world.motion[3]) / DT for stop in ELEVATOR_STOPS]
        return GliderState(world.step + 1, advance(world.motion, np.clip(rate, *room)))

    def signals(self, world: GliderState) -> Signals:
        """Return the seven columns by name."""
        return dict(zip(NAMES, world.motion, strict=True))

    def _command(self, world: GliderState) -> Floats:
        """Return the nominal elevator rate (N,) with feedback; sums column by column, never across rows."""
        at = np.minimum(world.step, len(self._inputs) - 1)
        rate = self._inputs[at]
        for i, column in enumerate(world.motion):
            rate = rate - self._gains[at, i] * (column - self._reference[at, i])
        return np.asarray(rate)
