"""Options of the core's estimators."""

from __future__ import annotations

from pydantic import Field, model_validator

from avrare.base.memory import MEMORY_OPTION
from avrare.plugin import Options


class McConfig(Options):
    """Options of Monte Carlo: independent rollouts, all specifications scored in one pass."""

    rollouts: int = Field(
        default=1000,
        ge=1,
        le=10**15,
        description="rollouts of each run; with relative_error or threshold, the most (default 1e6 then)",
    )
    early_stop: bool = Field(
        default=False,
        description="end a rollout once no verdict can change; robustness is then that of the samples so far",
    )
    runs: int = Field(default=1, ge=1, le=10**6, description="independent repetitions behind one interval")
    relative_error: float | None = Field(
        default=None, ge=1e-3, lt=1.0, description="stop when the estimate is as exact as this"
    )

    threshold: float | None = Field(
        default=None,
        gt=0.0,
        lt=1.0,
        description="stop as soon as it is known on which side of this the probability lies",
    )

    memory: float | None = Field(default=None, gt=0.0, description=MEMORY_OPTION)

    @model_validator(mode="after")
    def _check_sequence(self) -> McConfig:
        rules = [name for name in ("relative_error", "threshold") if getattr(self, name) is not None]
        if len(rules) > 1:
            raise ValueError("relative_error and threshold are two stopping rules: choose one")
        if rules and self.runs > 1:
            raise ValueError(f"{rules[0]} is a stopping rule for a single run; leave runs at 1")
        if rules and "rollouts" not in self.model_fields_set:
            # Not by assignment: an option that is not given must not count as given.
            self.__dict__["rollouts"] = 10**6  # a specification that never fails must end, too
        return self

    @property
    def sequential(self) -> bool:
        """True where a stopping rule decides the number of rollouts."""
        return self.relative_error is not None or self.threshold is not None
