"""Options of the tank and of its specification; this module imports only pydantic."""

from __future__ import annotations

from pydantic import Field

from avrare.plugin import Options


class TankConfig(Options):
    """Options of the simulator ``tank``."""

    dt: float = Field(default=10.0, gt=0.0, description="time step [s]; converts time bounds of formulas")
    area: float = Field(default=2.0, gt=0.0, description="surface area of the water [m^2]")
    rim: float = Field(default=2.0, gt=0.0, description="height of the rim above the valve [m]")
    start: float = Field(default=1.0, ge=0.0, description="level at t = 0, at most `rim` [m]")
    valve: float = Field(default=0.002, gt=0.0, description="cross-section of the outlet [m^2]")
    inflow: float = Field(default=0.008, gt=0.0, description="median inflow [m^3/s]")
    surge: float = Field(default=0.4, ge=0.0, description="standard deviation of the logarithm of the inflow")
    memory: float = Field(default=120.0, gt=0.0, description="decay time of a surge [s]")


class SpillageConfig(Options):
    """Options of the specification ``spillage``."""

    limit: float = Field(default=0.5, ge=0.0, description="maximal spilled volume [m^3]")
