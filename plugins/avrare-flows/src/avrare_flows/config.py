"""Options of ``transformed``: laws of the noise, in the units of the simulator."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from avrare.base.errors import AvrareError
from avrare.plugin import Options
from avrare.plugin.registry import default_registry
from avrare.scenario.fingerprint import named_files
from avrare.scenario.validation import check_options


def _convert_to_tuples(value: object) -> object:
    # Frozen models hold no lists.
    return tuple(_convert_to_tuples(entry) for entry in value) if isinstance(value, list | tuple) else value


def _law_tuple(value: object) -> object:
    return _convert_to_tuples([value] if isinstance(value, dict) else value)


class RestrictableLaw(Options):
    """Law whose numbers may be restricted to a range."""

    low: float | None = Field(default=None, description="the law is restricted to numbers above")
    high: float | None = Field(default=None, description="the law is restricted to numbers up to this")


class NormalLaw(RestrictableLaw):
    """Normal law N(mean, std^2)."""

    law: Literal["normal"]
    mean: float = Field(default=0.0, description="expected number")
    std: float = Field(default=1.0, gt=0.0, description="standard deviation")


class LogNormalLaw(RestrictableLaw):
    """Lognormal law: exp of N(mean, std^2)."""

    law: Literal["lognormal"]
    mean: float = Field(default=0.0, description="mean of the logarithm")
    std: float = Field(default=1.0, gt=0.0, description="standard deviation of the logarithm")


class ExponentialLaw(RestrictableLaw):
    """Exponential law."""

    law: Literal["exponential"]
    scale: float = Field(default=1.0, gt=0.0, description="mean")


class WeibullLaw(RestrictableLaw):
    """Weibull law."""

    law: Literal["weibull"]
    shape: float = Field(gt=0.0, description="exponent")
    scale: float = Field(default=1.0, gt=0.0, description="scale")


class GammaLaw(RestrictableLaw):
    """Gamma law."""

    law: Literal["gamma"]
    shape: float = Field(gt=0.0, description="mean over scale")
    scale: float = Field(default=1.0, gt=0.0, description="scale")


class GumbelLaw(RestrictableLaw):
    """Gumbel law of largest values."""

    law: Literal["gumbel"]
    location: float = Field(default=0.0, description="mode")
    scale: float = Field(default=1.0, gt=0.0, description="scale")


class StudentLaw(RestrictableLaw):
    """Student's t with location and scale."""

    law: Literal["student_t"]
    freedom: float = Field(gt=0.0, description="degrees of freedom: the smaller, the heavier the tails")
    location: float = Field(default=0.0, description="median")
    scale: float = Field(default=1.0, gt=0.0, description="scale")


class UniformLaw(Options):
    """Uniform law on [low, high]."""

    law: Literal["uniform"]
    low: float = Field(default=0.0, description="least number")
    high: float = Field(default=1.0, description="largest number")


class BeamLaw(Options):
    """Readings of a range sensor (beam model)."""

    law: Literal["beam"]
    distance: float = Field(gt=0.0, description="distance of the target [m]")
    most: float = Field(gt=0.0, description="range of the sensor, its reading without a target [m]")
    std: float = Field(gt=0.0, description="standard deviation of the readings of the target [m]")
    decay: float = Field(default=1.0, gt=0.0, description="mean reading of nearer obstacles [m]")
    hit: float = Field(gt=0.0, description="weight of the readings of the target")
    short: float = Field(default=0.0, ge=0.0, description="weight of the readings of nearer obstacles")
    nothing: float = Field(default=0.0, ge=0.0, description="weight of `most` itself")
    anything: float = Field(default=0.0, ge=0.0, description="weight of uniform readings")


class ScipyLaw(RestrictableLaw):
    """Distribution of scipy.stats by its name."""

    law: Literal["scipy"]
    name: str = Field(description="name of the distribution in scipy.stats, e.g. skewnorm")
    options: dict[str, float] = Field(default={}, description="its parameters by name, loc and scale too")


class PointLaw(Options):
    """A single number; for mixtures."""

    law: Literal["point"]
    value: float = Field(default=0.0, description="the number")


class MixtureLaw(RestrictableLaw):
    """Mixture of several laws."""

    law: Literal["mixture"]
    weights: Annotated[tuple[float, ...], BeforeValidator(_convert_to_tuples)] = Field(
        description="weight of each law"
    )
    laws: Annotated[tuple[LawConfig, ...], BeforeValidator(_convert_to_tuples)] = Field(
        description="the laws"
    )


LawConfig = Annotated[
    NormalLaw | LogNormalLaw | ExponentialLaw | WeibullLaw | GammaLaw | GumbelLaw | StudentLaw | UniformLaw
    | BeamLaw | ScipyLaw | PointLaw | MixtureLaw,
    Field(discriminator="law"),
]  # fmt: skip
MixtureLaw.model_rebuild()
Laws = Annotated[tuple[LawConfig, ...], BeforeValidator(_law_tuple), Field(min_length=1)]
Matrix = Annotated[tuple[tuple[float, ...], ...], BeforeValidator(_convert_to_tuples)]


class TransformedConfig(Options):
    """Options of the simulator ``transformed``: another simulator, and the laws of its noise."""

    simulator: dict[str, Any] = Field(description="block of the other simulator, {plugin: NAME, ...}")
    noise: Laws | None = Field(
        default=None, description="law of each number of a row of noise, or one law for all of them"
    )
    correlation: Matrix | None = Field(
        default=None, description="correlation of the normal numbers behind `noise` (Gaussian copula)"
    )
    flow: str | None = Field(
        default=None,
        description="file of a fitted flow (`avrare flow fit`), in place of `noise`",
        json_schema_extra={"file": True},
    )
    initial: Laws | None = Field(
        default=None, description="laws of row 0, the noise of the start, where they differ"
    )

    @model_validator(mode="after")
    def _check_choice(self) -> Self:
        if (self.noise is None) == (self.flow is None):
            raise ValueError("give either noise or flow")
        if self.correlation is not None and self.noise is None:
            raise ValueError("correlation belongs to noise")
        if "plugin" not in self.simulator:
            raise ValueError("simulator needs {plugin: NAME, ...}")
        return self

    def used_versions(self) -> dict[str, str]:
        """Version of the installed distribution that the other simulator comes from."""
        with suppress(AvrareError):  # told when it is built
            row = default_registry().find("simulator", str(self.simulator["plugin"]))
            return {row.distribution: row.version} if row.distribution else {}
        return {}

    def used_files(self) -> dict[str, Path]:
        """Files that the options of the other simulator name, by dotted option."""
        options = {key: value for key, value in self.simulator.items() if key != "plugin"}
        with suppress(AvrareError):
            component = default_registry().require("simulator", str(self.simulator["plugin"]))
            config = check_options(component.load_config(), component.name, options, "simulator")
            return {f"simulator.{name}": path for name, path in named_files(config)}
        return {}

    @property
    def dt(self) -> float | None:
        """Time step [s] of the other simulator, where its block gives one."""
        step = self.simulator.get("dt")
        return float(step) if isinstance(step, int | float) else None
