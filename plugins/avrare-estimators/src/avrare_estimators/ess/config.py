"""Options of ``ess``."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field

from avrare.plugin import Options
from avrare_estimators.common.config import GrowingConfig, allow_name


class PcnConfig(Options):
    """Preconditioned Crank-Nicolson steps."""

    name: Literal["pcn"] = "pcn"


class ShrinkConfig(Options):
    """Elliptical slices with a shrinking bracket."""

    name: Literal["shrink"] = "shrink"
    bracket: float = Field(
        default=2.0 * math.pi,
        gt=0.0,
        le=2.0 * math.pi,
        description="width of the first bracket [rad]; 3 saves a third of the rollouts where the set is "
        "narrow, and seldom changes sides (default: the complete ellipse)",
    )


class LipschitzConfig(Options):
    """Elliptical slices by a bound on the slope of the score."""

    name: Literal["lipschitz"] = "lipschitz"
    bound: float = Field(
        gt=0.0,
        description="bound on the score's slope, per unit of Euclidean length of the tape; without one use "
        "`kernel: shrink`",
    )


class GrowingLipschitzConfig(Options):
    """Algorithm 2 of stl-ess, biased."""

    name: Literal["lipschitz_growing"] = "lipschitz_growing"
    guess: float = Field(
        default=1.0, gt=0.0, description="first guess of the score's slope, per radian of an ellipse"
    )


class UcbConfig(Options):
    """Upper confidence bound."""

    name: Literal["ucb"] = "ucb"
    kappa: float = Field(
        default=2.576, ge=0.0, description="standard deviations above the mean; more explores"
    )


class _ImprovementConfig(Options):
    xi: float = Field(
        default=0.0,
        ge=0.0,
        description="improvement that does not count, in standard deviations of the scores so far; more "
        "explores",
    )


class EiConfig(_ImprovementConfig):
    """Expected improvement."""

    name: Literal["ei"] = "ei"


class PoiConfig(_ImprovementConfig):
    """Probability of improvement."""

    name: Literal["poi"] = "poi"


_Acquisition = Annotated[UcbConfig | EiConfig | PoiConfig, Field(discriminator="name")]
AcquisitionConfig = Annotated[_Acquisition, allow_name(Literal["ucb", "ei", "poi"], _Acquisition)]


class BayesianConfig(Options):
    """Algorithm 1 of stl-ess, biased."""

    name: Literal["bayesian"] = "bayesian"
    acquisition: AcquisitionConfig = Field(
        default=UcbConfig(),
        description="chooses the next angle: upper confidence bound (ucb), expected improvement (ei) or "
        "probability of improvement (poi)",
    )
    points: int = Field(default=6, ge=2, le=100, description="most rollouts of a round, N_BO")
    uncertainty: float = Field(
        default=0.0,
        ge=0.0,
        description="end a round once the surrogate is nowhere less certain than this, in standard "
        "deviations of the scores so far; 0: never",
    )


_Kernel = Annotated[
    PcnConfig | ShrinkConfig | LipschitzConfig | GrowingLipschitzConfig | BayesianConfig,
    Field(discriminator="name"),
]
KernelConfig = Annotated[
    _Kernel, allow_name(Literal["pcn", "shrink", "lipschitz_growing", "bayesian"], _Kernel)
]


class NestedLevelsConfig(GrowingConfig):
    """Options of nested levels with any kernel."""

    size = "chains"
    chains: int = Field(
        default=50,
        ge=2,
        le=1_000_000,
        description="parallel chains of a run; level_probability sets their length",
    )
    skip: int = Field(default=0, ge=0, le=100, description="steps of a chain between two samples that count")
    level_probability: float = Field(
        default=0.1,
        ge=1e-3,
        le=0.5,
        description="share of the samples above the next level; a chain gives 1 / this samples a level",
    )
    second_pass: bool = Field(
        default=True,
        description="count in a fresh sample at the levels that a pilot has found: unbiased; without it the "
        "pilot itself counts",
    )
    pilot: float = Field(
        default=0.25, gt=0.0, le=1.0, description="chains of the pilot over those that count; second_pass"
    )
    floor: float = Field(
        default=1e-18, gt=0.0, lt=1.0, description="a run ends, as extinct, once its weight falls below this"
    )

    @property
    def has_pilot(self) -> bool:
        """A pilot precedes the runs that count."""
        return self.second_pass

    @property
    def length(self) -> int:
        """Samples that a chain gives at each level."""
        return max(2, math.ceil(1.0 / self.level_probability - 1e-9))


class EssConfig(NestedLevelsConfig):
    """Nested levels (holmes-diaconis-ross) with Markov chains on the noise tape (stl-ess)."""

    kernel: KernelConfig = Field(
        default=PcnConfig(),
        description="how a chain moves: pcn, shrink, lipschitz; biased, to compare with the paper: "
        "lipschitz_growing, bayesian. A name, or {name: NAME, OPTION: VALUE}",
    )
