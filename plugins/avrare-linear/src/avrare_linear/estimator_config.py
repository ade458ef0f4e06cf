"""Options of the estimator ``ess_linear``."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from avrare_estimators.config import EssConfig


class LinearEssConfig(EssConfig):
    """Options of ``ess_linear``: those of ``ess`` except for the kernel, which has none."""

    kernel: Literal["exact"] = Field(  # type: ignore[assignment]
        default="exact", description="exact slices, the only choice"
    )
    moves: int = Field(default=4, ge=1, le=1000, description="slice moves of a chain between two rollouts")
