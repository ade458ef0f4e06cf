"""Options of the simulator ``glider``."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field

from avrare.plugin import Options


def _convert_to_tuple(value: object) -> object:
    """Convert a list to a tuple, since strict validation refuses lists."""
    return tuple(value) if isinstance(value, list) else value


Cost = Annotated[float, Field(ge=0.0)]
Costs = Annotated[tuple[Cost, Cost, Cost, Cost, Cost, Cost, Cost], BeforeValidator(_convert_to_tuple)]
_ORDER = "weights of the errors in x, z [1/m^2], pitch, elevator [1/rad^2], and the rates of x, z, pitch"


class NoiseConfig(Options):
    """Standard deviations of the noise."""

    x: float = Field(default=0.0, ge=0.0, description="of the horizontal position at the start [m]")
    z: float = Field(default=0.0, ge=0.0, description="of the height at the start [m]")
    actuator: float = Field(
        default=0.0, ge=0.0, description="of the noise of the elevator's rate, fresh each step [rad/s]"
    )


class FeedbackConfig(Options):
    """Cost that the feedback minimises; the defaults are those of the published controller."""

    state_cost: Costs = Field(default=(10.0, 10.0, 10.0, 1.0, 1.0, 1.0, 1.0), description=f"{_ORDER}, per s")
    input_cost: float = Field(
        default=0.1, gt=0.0, description="weight of the change of the elevator's rate [s^2/rad^2], per s"
    )
    final_cost: Costs = Field(
        default=(400.0, 400.0, 1.0 / 9.0, 1.0 / 9.0, 1.0, 1.0, 1.0 / 9.0), description=f"{_ORDER}, at the end"
    )


class GliderConfig(Options):
    """Noise and feedback of the glider."""

    noise: NoiseConfig = Field(default=NoiseConfig(), description="noise; default: none")
    feedback: FeedbackConfig | None = Field(
        default=FeedbackConfig(), description="feedback of the deviation from the nominal flight; null: none"
    )
