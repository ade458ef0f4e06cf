"""Options of nested levels with exact slices."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from avrare_estimators.ess_config import EssConfig


class LinearEssConfig(EssConfig):
    """Options of ``ess_linear``: those of ``ess`` but for the kernel, which needs none."""

    kernel: Literal["exact"] = Field(  # type: ignore[assignment]
        default="exact", description="exact slices; nothing else"
    )
    moves: int = Field(
        default=4, ge=1, le=1000, description="ellipses that a chain goes along between two rollouts"
    )
