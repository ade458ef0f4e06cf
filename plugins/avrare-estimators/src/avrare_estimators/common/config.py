"""Options that estimators share, and options of a choice by name."""

from __future__ import annotations

from typing import Any, ClassVar, Self

from pydantic import BeforeValidator, Field, field_serializer, model_validator

from avrare.base.memory import MEMORY_OPTION
from avrare.plugin import Options

LEAST_RUNS_OF_LOOK = 5
"""Fewer runs say too little about their scatter."""
LEAST_PILOT = 200
LEAST_DEFENSIVE = 0.25
LEARNED = "learned"


def allow_name(names: Any, choice: Any) -> BeforeValidator:
    """Return a validator that accepts a bare name for a choice without options.

    Args:
        names: Names that may stand alone, a ``Literal``.
        choice: Union of the models, each with its ``name``.
    """
    return BeforeValidator(_expand_name, json_schema_input_type=names | choice)


def _expand_name(choice: object) -> object:
    return {"name": choice} if isinstance(choice, str) else choice


class EstimatorConfig(Options):
    """Options of every estimator."""

    memory: float | None = Field(default=None, gt=0.0, description=MEMORY_OPTION)


class RunsConfig(EstimatorConfig):
    """Options of estimates by independent runs."""

    runs: int = Field(default=10, ge=1, le=10**6, description="independent repetitions behind one interval")
    relative_error: float | None = Field(
        default=None,
        ge=1e-3,
        lt=1.0,
        description="stop at the first look at which the runs' standard error is at most this share of their "
        "mean; looks come after at least `runs` runs, then at twice as many, ...",
    )
    most_runs: int = Field(default=320, ge=2, le=10**6, description="the most runs; with relative_error")

    @property
    def most(self) -> int:
        """Largest number of runs."""
        return self.runs if self.relative_error is None else self.most_runs

    @model_validator(mode="after")
    def _runs_suffice_to_stop(self) -> Self:
        if self.relative_error is not None and not LEAST_RUNS_OF_LOOK <= self.runs <= self.most_runs:
            raise ValueError(
                f"relative_error needs {LEAST_RUNS_OF_LOOK} to most_runs ({self.most_runs}) runs before it "
                f"may stop, not {self.runs}"
            )
        return self


class GrowingConfig(RunsConfig):
    """Options of runs of a size that a pilot may raise."""

    size: ClassVar[str]
    """Name of the option that sets the size of a run."""
    grow: bool | None = Field(
        default=None,
        description="up to 8 times larger runs where a pilot, which does not count, promises few roots, 2 "
        "times where 8 would not suffice (default: unless the size of a run is given)",
    )

    @property
    def has_pilot(self) -> bool:
        """A pilot precedes the runs that count."""
        return True

    @property
    def grows(self) -> bool:
        """The pilot may raise the size of a run."""
        if self.grow is None:
            return self.has_pilot and self.size not in self.model_fields_set
        return self.grow

    @field_serializer("grow")
    def _decide_growth(self, grow: bool | None) -> bool:
        return self.grows

    @model_validator(mode="after")
    def _grow_with_a_pilot(self) -> Self:
        if self.grow and not self.has_pilot:
            raise ValueError("grow needs a pilot, and this variant has none")
        return self


class WeightedConfig(EstimatorConfig):
    """Options of weighted samples."""

    runs: int = Field(default=1, ge=1, le=10**6, description="independent repetitions behind one interval")
    check: float = Field(
        default=0.15,
        ge=0.0,
        le=0.5,
        description="share of all rollouts that the cross-check of the failures takes; 0: none",
    )

    @property
    def target_share(self) -> float:
        """Share of a sample's rollouts drawn from the target itself."""
        raise NotImplementedError
