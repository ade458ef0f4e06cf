"""Options of ``auto``, which chooses an estimator for each specification."""

from __future__ import annotations

from pydantic import Field, model_validator

from avrare.base.memory import MEMORY_OPTION
from avrare.plugin import Options
from avrare.plugin.registry import default_registry


class AutoConfig(Options):
    """Options of the choice: a Monte Carlo pilot decides, by rules that are fixed before it runs."""

    relative_error: float | None = Field(
        default=None,
        ge=1e-3,
        lt=1.0,
        description="how exact each estimate is to be (default: 0.2 where neither rollouts nor a budget is "
        "given; else they are spent)",
    )
    rollouts: int | None = Field(
        default=None,
        ge=1,
        le=10**12,
        description="most rollouts of a specification, by the steps of complete ones, pilot and learning "
        "included (default: 50,000)",
    )
    threshold: float | None = Field(
        default=None,
        gt=0.0,
        lt=1.0,
        description="stop as soon as it is known on which side of this the probability lies (Monte Carlo)",
    )
    memory: float | None = Field(default=None, gt=0.0, description=MEMORY_OPTION)

    @model_validator(mode="after")
    def _check_rule(self) -> AutoConfig:
        if self.threshold is not None and self.relative_error is not None:
            raise ValueError("relative_error and threshold are two stopping rules: choose one")
        return self

    def used_versions(self) -> dict[str, str]:
        """Versions of the installed distributions that a chosen estimator may come from."""
        registry = default_registry()
        return registry.versions(candidate for candidate, _ in registry.candidates())
