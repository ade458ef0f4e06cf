"""Options of ``ce``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from avrare.plugin import Options
from avrare_estimators.common.config import WeightedConfig, allow_name


class GaussianFamilyConfig(Options):
    """Mixtures of Gaussians of the noise tape."""

    name: Literal["gaussian"] = "gaussian"
    smoothing: float = Field(
        default=0.8, gt=0.0, le=1.0, description="weight of a stage's fit over the law before it"
    )
    floor: float = Field(
        default=0.7, gt=0.0, le=1.0, description="least standard deviation of a learnt number; target: 1"
    )
    components: int | None = Field(
        default=None,
        ge=1,
        le=50,
        description="Gaussians in the mixture; default: one for every 100 rollouts to learn from, at most 4",
    )


class NetworkFamilyConfig(Options):
    """A network from the visible state of a vehicle to how it is perceived."""

    name: Literal["network"] = "network"
    hidden: int = Field(default=100, ge=1, le=2000, description="width of both hidden layers")
    epochs: int = Field(default=300, ge=1, description="training steps of a stage, all data each")
    rate: float = Field(default=1e-3, gt=0.0, description="Adam's learning rate")


_Family = Annotated[GaussianFamilyConfig | NetworkFamilyConfig, Field(discriminator="name")]
FamilyConfig = Annotated[_Family, allow_name(Literal["gaussian", "network"], _Family)]


class CeConfig(WeightedConfig):
    """The cross-entropy method: learn a proposal from the rollouts nearest to failure, then sample afresh."""

    rollouts: int = Field(default=5000, ge=20, le=10**9, description="rollouts of each stage")
    defensive: float = Field(
        default=0.2, ge=0.0, lt=1.0, description="share of a sample's rollouts drawn from the target itself"
    )
    stages: int = Field(default=10, ge=1, le=1000, description="largest number of learning stages")
    elite: float = Field(default=0.1, gt=0.0, le=0.5, description="share of a stage's rollouts to learn from")
    family: FamilyConfig = Field(
        default=GaussianFamilyConfig(),
        description="law to learn: Gaussian in the noise, or a network from the visible state of a "
        "vehicle to how it is perceived (needs torch). A name, or {name: NAME, OPTION: VALUE}",
    )

    @property
    def target_share(self) -> float:
        """Share of a sample's rollouts drawn from the target itself."""
        return self.defensive
