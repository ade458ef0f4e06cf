"""Exposures: how often a scene occurs, per hour or per km."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, NonNegativeInt, model_validator

Unit = Literal["hour", "km", "cell"]
"""Unit of a rate; of a grid of scenes without exposures, a cell."""
Positive = Annotated[float, Field(gt=0.0)]


class Exposure(BaseModel):
    """Exposure to a scene: a count or counts over hours or km, or a rate with an interval."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    count: int | None = Field(default=None, ge=0, description="times that the scene was met")
    counts: tuple[NonNegativeInt, ...] | None = Field(
        default=None, min_length=2, description="times in each of several blocks of driving of equal length"
    )
    hours: Positive | None = Field(
        default=None, description="hours of driving in which it was counted; with counts those of one block"
    )
    km: Positive | None = Field(default=None, description="km of driving, in place of hours")
    per_hour: Positive | None = Field(default=None, description="times per hour, in place of a count")
    per_km: Positive | None = Field(default=None, description="times per km, in place of a count")
    interval: tuple[float, float] | None = Field(
        default=None, description="confidence interval of per_hour or per_km; none: it is known exactly"
    )
    confidence: float = Field(default=0.95, gt=0.0, lt=1.0, description="level of that interval, in (0, 1)")

    @model_validator(mode="after")
    def _check_unit(self) -> Self:
        rates = [
            name for name in ("count", "counts", "per_hour", "per_km") if getattr(self, name) is not None
        ]
        if len(rates) != 1:
            raise ValueError("give one of count, counts, per_hour and per_km")
        over = [name for name in ("hours", "km") if getattr(self, name) is not None]
        if len(over) != (rates[0] in ("count", "counts")):
            raise ValueError("count and counts need one of hours and km; per_hour and per_km take neither")
        if self.interval is not None:
            value, (low, high) = self.per_hour or self.per_km, self.interval
            if value is None or not 0.0 <= low <= value <= high:
                raise ValueError(
                    "interval must contain the value of per_hour or per_km, and not reach below 0"
                )
        return self

    @property
    def unit(self) -> Unit:
        """Unit that the rate is per."""
        return "hour" if self.hours is not None or self.per_hour is not None else "km"

    @property
    def total(self) -> int | None:
        """Number of times that the scene was counted; None without a count."""
        return sum(self.counts) if self.counts is not None else self.count
