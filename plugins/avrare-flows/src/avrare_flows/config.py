"""What a scenario says about noise. Units are those of the noise, which the simulator gives it."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator


def _tuple(value: Any) -> Any:
    """Lists as tuples: what is frozen holds no lists."""
    return tuple(_tuple(entry) for entry in value) if isinstance(value, list | tuple) else value


def _laws(value: Any) -> Any:
    """One law becomes a list of one."""
    return _tuple([value] if isinstance(value, dict) else value)


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class _Law(_Model):
    low: float | None = Field(default=None, description="the law is kept to what lies above")
    high: float | None = Field(default=None, description="the law is kept to what does not lie above")


class NormalLaw(_Law):
    """N(mean, std^2)."""

    law: Literal["normal"]
    mean: float = Field(default=0.0, description="expected number")
    std: float = Field(default=1.0, gt=0.0, description="standard deviation")


class LogNormalLaw(_Law):
    """exp of N(mean, std^2)."""

    law: Literal["lognormal"]
    mean: float = Field(default=0.0, description="of the logarithm")
    std: float = Field(default=1.0, gt=0.0, description="of the logarithm")


class ExponentialLaw(_Law):
    """Exponential."""

    law: Literal["exponential"]
    scale: float = Field(default=1.0, gt=0.0, description="mean")


class WeibullLaw(_Law):
    """Weibull."""

    law: Literal["weibull"]
    shape: float = Field(gt=0.0, description="exponent")
    scale: float = Field(default=1.0, gt=0.0, description="unit of length")


class GammaLaw(_Law):
    """Gamma."""

    law: Literal["gamma"]
    shape: float = Field(gt=0.0, description="mean over scale")
    scale: float = Field(default=1.0, gt=0.0, description="unit of length")


class GumbelLaw(_Law):
    """Of largest values."""

    law: Literal["gumbel"]
    location: float = Field(default=0.0, description="mode")
    scale: float = Field(default=1.0, gt=0.0, description="unit of length")


class StudentLaw(_Law):
    """Student's t, moved and stretched."""

    law: Literal["student_t"]
    freedom: float = Field(gt=0.0, description="degrees of freedom: the smaller, the heavier the tails")
    location: float = Field(default=0.0, description="median")
    scale: float = Field(default=1.0, gt=0.0, description="unit of length")


class UniformLaw(_Model):
    """All of [low, high] alike."""

    law: Literal["uniform"]
    low: float = Field(default=0.0, description="least number")
    high: float = Field(default=1.0, description="largest number")


class BeamLaw(_Model):
    """What a range sensor reads (beam model)."""

    law: Literal["beam"]
    distance: float = Field(gt=0.0, description="to what is to be measured [m]")
    most: float = Field(gt=0.0, description="the sensor's range, which it reads when it sees nothing [m]")
    std: float = Field(gt=0.0, description="of the readings about the distance [m]")
    decay: float = Field(default=1.0, gt=0.0, description="mean of the readings of what comes between [m]")
    hit: float = Field(gt=0.0, description="weight of the readings about the distance")
    short: float = Field(default=0.0, ge=0.0, description="weight of those of what comes between")
    nothing: float = Field(default=0.0, ge=0.0, description="weight of `most` itself")
    anything: float = Field(default=0.0, ge=0.0, description="weight of uniform readings")


class ScipyLaw(_Law):
    """A distribution of scipy.stats by its name."""

    law: Literal["scipy"]
    name: str = Field(description="of the distribution in scipy.stats, e.g. skewnorm")
    options: dict[str, float] = Field(default={}, description="its parameters by name, loc and scale too")


class PointLaw(_Model):
    """Always the same number; for mixtures."""

    law: Literal["point"]
    value: float = Field(default=0.0, description="the number")


class MixtureLaw(_Law):
    """One of several laws, by chance."""

    law: Literal["mixture"]
    weights: Annotated[tuple[float, ...], BeforeValidator(_tuple)] = Field(description="one for each law")
    laws: Annotated[tuple[LawConfig, ...], BeforeValidator(_tuple)] = Field(description="the laws")


LawConfig = Annotated[
    NormalLaw | LogNormalLaw | ExponentialLaw | WeibullLaw | GammaLaw | GumbelLaw | StudentLaw | UniformLaw
    | BeamLaw | ScipyLaw | PointLaw | MixtureLaw,
    Field(discriminator="law"),
]  # fmt: skip
MixtureLaw.model_rebuild()
Laws = Annotated[tuple[LawConfig, ...], BeforeValidator(_laws), Field(min_length=1)]
Matrix = Annotated[tuple[tuple[float, ...], ...], BeforeValidator(_tuple)]


class TransformedConfig(_Model):
    """Options of the simulator ``transformed``: another simulator, and the laws of its noise."""

    simulator: dict[str, Any] = Field(description="block of the other simulator, {plugin: NAME, ...}")
    noise: Laws | None = Field(
        default=None, description="law of each number of a row of noise, or one law for all of them"
    )
    correlation: Matrix | None = Field(
        default=None, description="of the normal numbers behind `noise` (Gaussian copula); without: none"
    )
    flow: str | None = Field(
        default=None,
        description="file of a fitted flow (`avrare flow fit`), in place of `noise`",
        json_schema_extra={"file": True},
    )
    initial: Laws | None = Field(
        default=None, description="laws of row 0, the noise of the start, where they are others"
    )

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.noise is None) == (self.flow is None):
            raise ValueError("give either noise or flow")
        if self.correlation is not None and self.noise is None:
            raise ValueError("correlation belongs to noise")
        if "plugin" not in self.simulator:
            raise ValueError("simulator needs {plugin: NAME, ...}")
        return self

    @property
    def dt(self) -> float | None:
        """Step [s] of the other simulator, where its block tells."""
        found = self.simulator.get("dt")
        return float(found) if isinstance(found, int | float) else None
