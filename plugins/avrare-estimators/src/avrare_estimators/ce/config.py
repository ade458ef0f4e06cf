"""Options of ``ce``."""

from __future__ import annotations

from pydantic import Field

from avrare_estimators.common.config import WeightedConfig


class CeConfig(WeightedConfig):
    """The cross-entropy method: learn a proposal from rollouts near failure, then draw a new sample."""

    rollouts: int = Field(default=5000, ge=20, le=10**9, description="rollouts of each stage")
    defensive: float = Field(
        default=0.2, ge=0.0, lt=1.0, description="share of a sample's rollouts drawn from the target itself"
    )
    stages: int = Field(default=10, ge=1, le=1000, description="largest number of learning stages")
    elite: float = Field(default=0.1, gt=0.0, le=0.5, description="share of a stage's rollouts to learn from")
    hidden: int = Field(
        default=100, ge=1, le=2000, description="width of both hidden layers of the network that is learned"
    )
    epochs: int = Field(default=300, ge=1, description="training steps of a stage, all data each")
    rate: float = Field(default=1e-3, gt=0.0, description="Adam's learning rate")

    @property
    def target_share(self) -> float:
        """Share of a sample's rollouts drawn from the target itself."""
        return self.defensive
