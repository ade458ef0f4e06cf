"""Options of the estimators."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from avrare.base.errors import AvrareError
from avrare.base.memory import MEMORY_OPTION
from avrare_estimators.importance.proposals import validate_proposal

LEAST_RUNS_OF_LOOK = 5
"""Fewer runs say too little of their own scatter."""
LEARNED = "learned"
LEAST_PILOT = 200
LEAST_DEFENSIVE = 0.25
MOST_ROLLOUTS = 300_000
"""Upper bound of a sample with a stopping rule: a failure that is never met must end, too."""
KernelName = Literal["pcn", "shrink", "lipschitz", "surrogate", "lipschitz_growing", "bayesian"]


class _Config(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    memory: float | None = Field(default=None, gt=0.0, description=MEMORY_OPTION)


class _RunsConfig(_Config):
    """Options of estimates by independent runs."""

    runs: int = Field(default=10, ge=1, le=10**6, description="independent repetitions behind one interval")
    relative_error: float | None = Field(
        default=None, ge=1e-3, lt=1.0,
        description="stop at the first look at which the runs' standard error is at most this share of their "
        "mean; looks come after at least `runs` runs, then at twice as many, ...",
    )  # fmt: skip
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


class _GrowingConfig(_RunsConfig):
    """Options of runs of a size that a pilot may raise."""

    size: ClassVar[str]
    """Name of the option that sets the size of a run."""
    grow: bool | None = Field(
        default=None,
        description="up to 8 times larger runs where a pilot, which does not count, promises few roots, 2 "
        "times where 8 would not suffice (default: unless the size of a run is given)",
    )

    @model_validator(mode="after")
    def _grow_with_a_pilot(self) -> Self:
        if self.grow is None:
            # Not by assignment: an option that is not given must not count as given.
            self.__dict__["grow"] = self.size not in self.model_fields_set and self._may_grow
        elif self.grow and not self._may_grow:
            raise ValueError("grow needs a pilot, and this variant has none")
        return self

    @property
    def _may_grow(self) -> bool:
        return True


class AmsConfig(_GrowingConfig):
    """Adaptive multilevel splitting (stl-ams, Algorithm 2, in its unbiased form)."""

    size = "particles"
    particles: int = Field(default=250, ge=2, le=10**9, description="N, particles of a run")
    discard: int = Field(default=25, ge=1, description="K, particles discarded at each level (more on ties)")
    variant: Literal["unbiased", "published"] = Field(
        default="unbiased",
        description="published: Algorithm 2 of stl-ams as its code ran it, for comparison: K + 1 discarded, "
        "levels on the robustness of the prefix, robustness <= 0 is failure",
    )
    look_ahead: int | None = Field(
        default=None, ge=1,
        description="score by the robustness of the noise-free continuation, every so many steps, in place "
        "of the problem's score; its steps are counted apart, as look_ahead_steps",
    )  # fmt: skip
    score: Literal["problem", "learned"] = Field(
        default="problem",
        description="learned: score by the committor that a network learns in a run which does not count, "
        "where rollouts held out promise a gain over the problem's own score",
    )
    pilot: int = Field(
        default=1000,
        ge=LEAST_PILOT,
        description="particles of the run to learn the score from; score: learned",
    )
    learned: str | None = Field(
        default=None,
        description="file of a learned score (learned.json of a run folder): score by it, without learning",
        json_schema_extra={"file": True},
    )
    early_stop: bool = Field(
        default=False,
        description="end a rollout once its verdict cannot change; robustness is that of the samples so far",
    )
    floor: float = Field(
        default=1e-18, gt=0.0, lt=1.0, description="a run ends, as extinct, once its weight falls below this"
    )

    @property
    def _may_grow(self) -> bool:
        return self.variant == "unbiased"

    @model_validator(mode="after")
    def _fit_variant(self) -> AmsConfig:
        for name in ("early_stop", "look_ahead"):
            if getattr(self, name) and self.variant == "published":
                raise ValueError(f"{name} is no option of the published variant: leave it out")
            if getattr(self, name) and self.scores_by_committor:
                raise ValueError(f"{name} does not go with a learned score: leave one of them out")
        if self.scores_by_committor and self.variant == "published":
            raise ValueError("a learned score is no option of the published variant: leave it out")
        if self.pilot != type(self).model_fields["pilot"].default and self.score != LEARNED:
            raise ValueError("pilot belongs to `score: learned`")
        return self

    @property
    def scores_by_committor(self) -> bool:
        """A learned score is asked for, or given."""
        return self.score == LEARNED or self.learned is not None

    @model_validator(mode="after")
    def _discard_fewer_than_all(self) -> AmsConfig:
        if self.discard >= self.particles:
            given = "" if "discard" in self.model_fields_set else ", its default"
            text = f"discard ({self.discard}{given}) must be less than particles ({self.particles}): set both"
            raise ValueError(text)
        return self


class EssConfig(_GrowingConfig):
    """Nested levels (holmes-diaconis-ross) with Markov chains on the noise tape (stl-ess)."""

    size = "chains"
    chains: int = Field(
        default=50, ge=2, le=1_000_000,
        description="parallel chains of a run; level_probability sets their length",
    )  # fmt: skip
    skip: int = Field(default=0, ge=0, le=100, description="steps of a chain between two samples that count")
    level_probability: float = Field(
        default=0.1, ge=1e-3, le=0.5,
        description="share of the samples above the next level; a chain gives 1 / this samples a level",
    )  # fmt: skip
    kernel: KernelName = Field(
        default="pcn",
        description="how a chain moves. Valid: pcn, shrink, lipschitz, surrogate; biased, to compare with "
        "the paper: lipschitz_growing, bayesian",
    )
    lipschitz: float | None = Field(
        default=None, gt=0.0,
        description="lipschitz: bound on the slope of the score, per unit of Euclidean length of the tape; "
        "lipschitz_growing: first guess of it per radian of an ellipse (1)",
    )  # fmt: skip
    bracket: float | None = Field(
        default=None, gt=0.0, lt=2.0 * math.pi,
        description="shrink: width of the first bracket, radians; 3 saves a third of the rollouts where the "
        "set is narrow, and seldom changes sides (default: the complete ellipse)",
    )  # fmt: skip
    acquisition: Literal["ucb", "ei", "poi"] = Field(
        default="ucb",
        description="bayesian: what chooses the next angle: upper confidence bound, expected improvement, "
        "probability of improvement",
    )
    kappa: float = Field(
        default=2.576, ge=0.0, description="bayesian, ucb: standard deviations above the mean; more explores"
    )
    xi: float = Field(
        default=0.0, ge=0.0,
        description="bayesian, ei and poi: improvement that does not count, in standard deviations of the "
        "scores so far; more explores",
    )  # fmt: skip
    points: int = Field(default=6, ge=2, le=100, description="bayesian: most rollouts of a round, N_BO")
    uncertainty: float = Field(
        default=0.0, ge=0.0,
        description="bayesian: end a round once the surrogate is nowhere less certain than this, in standard "
        "deviations of the scores so far; 0: never",
    )  # fmt: skip
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

    @model_validator(mode="after")
    def _options_fit_kernel(self) -> EssConfig:
        if self.kernel == "lipschitz" and self.lipschitz is None:
            raise ValueError(
                "kernel lipschitz needs lipschitz, a bound on the score's slope; without one use shrink"
            )
        if self.lipschitz is not None and not self.kernel.startswith("lipschitz"):
            raise ValueError(f"lipschitz is no option of kernel {self.kernel}")
        if self.bracket is not None and self.kernel != "shrink":
            raise ValueError(f"bracket is no option of kernel {self.kernel}")
        for name in ("acquisition", "kappa", "xi", "points", "uncertainty"):
            changed = getattr(self, name) != type(self).model_fields[name].default
            if changed and self.kernel != "bayesian":
                raise ValueError(f"{name} is no option of kernel {self.kernel}")
        if self.xi > 0.0 and self.acquisition == "ucb":
            raise ValueError("xi is no option of acquisition ucb, which has kappa")
        return self

    @property
    def _may_grow(self) -> bool:
        return self.second_pass

    @property
    def length(self) -> int:
        """Samples that a chain gives at each level."""
        return max(2, math.ceil(1.0 / self.level_probability - 1e-9))


class _WeightedConfig(_Config):
    runs: int = Field(default=1, ge=1, le=10**6, description="independent repetitions behind one interval")
    defensive: float = Field(
        default=0.2, ge=0.0, lt=1.0, description="share of a sample's rollouts drawn from the target itself"
    )
    check: float = Field(
        default=0.15, ge=0.0, le=0.5,
        description="share of all rollouts that the cross-check of the failures takes; 0: none",
    )  # fmt: skip


MOST_CLIMBING_RUNS = 16
"""Runs that have addresses of their own for the noise of their chains."""


class IsConfig(_WeightedConfig):
    """Importance sampling from a proposal that is learnt on the noise tape, or given."""

    rollouts: int = Field(
        default=30_000, ge=2, le=10**12,
        description="rollouts of each run, its learning and cross-check included; with relative_error, the "
        "most (default 300,000 then)",
    )  # fmt: skip
    defensive: float = Field(
        default=0.5, ge=0.0, lt=1.0,
        description="share of a sample's rollouts drawn from the target itself (learned: at least 0.25, the "
        "default then)",
    )  # fmt: skip
    proposal: Any = Field(
        default=LEARNED,
        description="learned, {gaussian: {mean: ..., std: ...}} of the noise, or {plugin: NAME, ...}: a "
        "perception model with log_prob",
    )
    learned: str | None = Field(
        default=None,
        description="file of a learned proposal (learned.json of a run folder), to draw from without a pilot",
        json_schema_extra={"file": True},
    )
    pilot: int = Field(
        default=3000, ge=200,
        description="rollouts of the target to begin to learn from, at most a sixth of all; each later stage "
        "has half as many; learned",
    )  # fmt: skip
    stages: int = Field(default=8, ge=1, le=50, description="most stages after the pilot; learned")
    relative_error: float | None = Field(
        default=None, ge=1e-3, lt=1.0,
        description="stop at the first look at which the standard error is at most this share of the "
        "estimate; learned",
    )  # fmt: skip

    climb: bool = Field(
        default=False,
        description="where failures are rarer than a proposal reaches well, sample a level on the way and go "
        "on to failure by Markov chains; learned",
    )
    fall_back: bool = Field(
        default=True,
        description="where learning finds nothing, draw from the target; false: end with an error, also "
        "where it did not reach a failure; learned",
    )

    @property
    def learns(self) -> bool:
        """The proposal is on the noise tape, and is learnt or was."""
        return isinstance(self.proposal, str)

    @model_validator(mode="after")
    def _fit_learning(self) -> Self:
        given = self.model_fields_set
        if not self.learns:
            # A resolved scenario, such as that of a run folder, gives all options.
            names, fields = ("learned", "pilot", "stages", "relative_error"), type(self).model_fields
            if other := [
                name for name in names if name in given and getattr(self, name) != fields[name].default
            ]:
                raise ValueError(f"{other[0]} belongs to `proposal: learned`, not to a given proposal")
            return self
        # Not by assignment: an option that is not given must not count as given.
        if "defensive" not in given:
            self.__dict__["defensive"] = LEAST_DEFENSIVE
        if self.defensive < LEAST_DEFENSIVE:
            raise ValueError(f"defensive must be at least {LEAST_DEFENSIVE} for a learned proposal")
        if self.climb and self.runs > MOST_CLIMBING_RUNS:
            raise ValueError(f"climb takes at most {MOST_CLIMBING_RUNS} runs; it needs one, of many groups")
        if self.relative_error is not None:
            if self.runs > 1:
                raise ValueError("relative_error is a stopping rule for a single run; leave runs at 1")
            if "rollouts" not in given:
                self.__dict__["rollouts"] = MOST_ROLLOUTS
        return self

    @field_validator("proposal")
    @classmethod
    def _check_proposal(cls, proposal: Any) -> Any:
        if proposal == LEARNED:
            return proposal
        try:
            validate_proposal(proposal)
        except AvrareError as error:
            raise ValueError(f"{error.message} ({error.hint})" if error.hint else error.message) from None
        return proposal


class CeConfig(_WeightedConfig):
    """The cross-entropy method: learn a proposal from the rollouts nearest to failure, then sample afresh."""

    rollouts: int = Field(default=5000, ge=20, le=10**9, description="rollouts of each stage")
    stages: int = Field(default=10, ge=1, le=1000, description="largest number of learning stages")
    elite: float = Field(default=0.1, gt=0.0, le=0.5, description="share of a stage's rollouts to learn from")
    family: Literal["gaussian", "network"] = Field(
        default="gaussian",
        description="what is learnt: a Gaussian law of the noise, or a network from the visible state of a "
        "vehicle to how it is perceived (needs torch)",
    )
    smoothing: float = Field(
        default=0.8, gt=0.0, le=1.0, description="weight of what a stage learns over what was known; gaussian"
    )
    floor: float = Field(
        default=0.7, gt=0.0, le=1.0, description="least standard deviation of a learnt number; target: 1"
    )
    components: int | None = Field(
        default=None, ge=1, le=50,
        description="Gaussians in the mixture; default: one for every 100 rollouts to learn from, at most 4",
    )  # fmt: skip
    hidden: int = Field(default=100, ge=1, le=2000, description="width of both hidden layers; network")
    epochs: int = Field(default=300, ge=1, description="training steps of a stage, all data each; network")
    rate: float = Field(default=1e-3, gt=0.0, description="Adam's learning rate; network")


class SmcConfig(_RunsConfig):
    """Sequential Monte Carlo with potentials that are learnt (twisted SMC)."""

    particles: int = Field(default=1000, ge=20, le=10**8, description="N, particles of a run")
    proposal: Literal["learned", "none"] = Field(
        default="learned",
        description="learned: particles draw their noise from a proposal that is learnt on the tape, as `is` "
        "does, where it gains; none: from the target",
    )
    learned: str | None = Field(
        default=None,
        description="file of a learned proposal and potentials (learned.json of a run of smc): no pilot",
        json_schema_extra={"file": True},
    )
    pilot: int = Field(
        default=3000, ge=200,
        description="rollouts of the target to begin to learn from; each later stage has half as many",
    )  # fmt: skip
    stages: int = Field(default=8, ge=0, le=50, description="most stages of learning after the pilot")
    defensive: float = Field(
        default=LEAST_DEFENSIVE, ge=LEAST_DEFENSIVE, lt=1.0,
        description="share of the target in the law that particles are drawn from; learned",
    )  # fmt: skip
    times: int = Field(
        default=16, ge=1, le=200, description="most steps of a rollout at which particles may be resampled"
    )
