"""Options of the estimator ``ess_linear``."""

from __future__ import annotations

from pydantic import Field

from avrare_estimators.ess.config import NestedLevelsConfig


class LinearEssConfig(NestedLevelsConfig):
    """Options of ``ess_linear``: those of ``ess`` without a choice of the kernel."""

    moves: int = Field(default=4, ge=1, le=1000, description="slice moves of a chain between two rollouts")
