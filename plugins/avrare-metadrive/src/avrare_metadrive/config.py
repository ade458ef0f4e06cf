"""Options of the simulator ``metadrive`` and of its driver, and the signals. SI units."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from avrare.plugin import Options

DT = 0.1
"""Time step [s]: five integration steps of MetaDrive."""
RANGE = 50
"""Range of the lidar [m]."""
SIGNALS = (
    "x", "y", "heading", "speed", "completion", "remaining", "nearest", "reward",
    "arrived", "crashed", "off_road", "over",
)  # fmt: skip
"""Signals, in this order; the expert's observation follows them, rays last.

x and y [m], heading [rad], speed [m/s], completion of the route in [0, 1], remaining route [m], nearest true
lidar reading [m], MetaDrive's accumulated reward; the others are 0 or 1.
"""


class NoiseConfig(Options):
    """Noise on every lidar ray, independent between steps."""

    variance: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="variance of a reading: normal around the true distance / 50 m, truncated to [0, 1]; "
        "0: no noise",
    )


class MetaDriveConfig(Options):
    """Options of the simulator ``metadrive``."""

    map: str = Field(
        default="r",
        pattern="^[SCrRXOTyY]+$",
        description="MetaDrive blocks in order: S straight, C curve, r on-ramp, R off-ramp, "
        "X crossing, T junction, O roundabout, y fewer lanes, Y more lanes",
    )
    traffic_density: float = Field(
        default=0.1,
        ge=0.0,
        le=1.0,
        description="fraction of the spawn places (10 m of lane each) with a vehicle",
    )
    traffic_mode: Literal["trigger", "respawn", "hybrid"] = Field(
        default="trigger",
        description="trigger: other vehicles start when the ego approaches; respawn: they drive from the "
        "start and reappear; hybrid: both",
    )
    start_seed: int = Field(
        default=0, ge=0, le=2**31 - 1, description="seed of map, traffic and start, the same in all rollouts"
    )
    lasers: int = Field(default=240, ge=1, le=4096, description="number of lidar rays; the expert needs 240")
    noise: NoiseConfig = Field(default_factory=NoiseConfig, description="noise on the rays")
    copy_by: Literal["fork", "replay"] = Field(
        default="fork",
        alias="copy",
        description="how the state is copied at a branch: fork keeps a suspended process; "
        "replay repeats the steps from the start",
    )
    step_timeout: float | None = Field(
        default=None,
        gt=0.0,
        le=86400.0,
        description="limit of a reset or step [s]; exceeding it is a rollout error",
    )


class ExpertConfig(Options):
    """Options of the controller ``metadrive_expert``: none."""
