"""Options of an FMU."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, field_validator

from avrare.plugin import Options
from avrare.scenario.safe_mode import TRUST, is_safe


def _convert_to_tuple(value: object) -> object:
    """Convert a list to a tuple, since strict validation refuses lists."""
    return tuple(value) if isinstance(value, list) else value


Names = Annotated[tuple[str, ...], BeforeValidator(_convert_to_tuple)]


class FmuConfig(Options):
    """FMU, and its variables by name."""

    file: str = Field(min_length=1, description="FMU; its code is run", json_schema_extra={"file": True})
    inputs: Names = Field(
        (), description="inputs: a simulator's take the action, a controller's what it sees"
    )
    outputs: Names = Field(min_length=1, description="signals of a simulator, action of a controller")
    start: Mapping[str, float | bool | str] = Field({}, description="start values, in the FMU's units")
    dt: float = Field(0.1, gt=0.0, description="step [s]")
    copy_by: Literal["auto", "state", "replay"] = Field(
        "auto",
        alias="copy",
        description="how a rollout branches: state: by the FMU's state; replay: by its inputs; "
        "auto: by the state where canGetAndSetFMUstate is set",
    )

    @field_validator("file")
    @classmethod
    def _check_trust(cls, file: str) -> str:
        if is_safe():
            raise ValueError(f"safe mode: an FMU is code of no installed plugin; {TRUST}")
        return file


class SimulatorConfig(FmuConfig):
    """FMU of a simulator."""

    seen: Names = Field((), description="outputs that the controller sees; default: the signals")
    noise: Mapping[str, float] = Field(
        {}, description="inputs that get normal noise in each step: standard deviations by name"
    )
