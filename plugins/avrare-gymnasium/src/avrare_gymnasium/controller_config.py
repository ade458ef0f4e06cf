"""What a scenario says about the plain controllers."""

from __future__ import annotations

from typing import Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

Vector = tuple[float, ...]


class FeedbackConfig(BaseModel):
    """Options of the controller ``gym_feedback``: u = offset - gain (observation - reference)."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        json_schema_extra={"examples": [{"gain": [[1.0]]}]},
    )

    gain: tuple[Vector, ...] = Field(
        min_length=1, description="commands x observation; for a discrete space: commands as below"
    )
    reference: Vector | None = Field(default=None, description="observation to hold; without: 0")
    offset: Vector | None = Field(default=None, description="command where the reference is met; without: 0")

    @model_validator(mode="after")
    def _shapes(self) -> Self:
        width = len(self.gain[0])
        if any(len(row) != width for row in self.gain):
            raise ValueError("the rows of gain have different lengths")
        if self.reference is not None and len(self.reference) != width:
            raise ValueError(f"reference must have {width} numbers, one for each column of gain")
        if self.offset is not None and len(self.offset) != len(self.gain):
            raise ValueError(f"offset must have {len(self.gain)} numbers, one for each row of gain")
        return self


class ConstantConfig(BaseModel):
    """Options of the controller ``gym_constant``."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        json_schema_extra={"examples": [{"action": 0}]},
    )

    action: int | Vector = Field(description="a number of a discrete space, or the entries of a box")
