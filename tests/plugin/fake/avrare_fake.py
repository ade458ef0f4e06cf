"""A plugin for the tests: its factories would import heavy packages, its configs do not."""

from typing import Literal

from pydantic import Field, field_validator

from avrare.plugin import Component, Options, hookimpl


class Corner(Options):
    x: float = Field(description="along the road [m]")
    y: float = Field(0.0, description="across the road [m]")


class Map(Options):
    file: str = Field(description="file of the map", json_schema_extra={"file": True})


class SimulatorConfig(Options):
    dt: float = Field(0.1, gt=0, description="step [s]")
    gap: float = Field(30.0, description="initial gap [m]")
    lanes: int = Field(2, ge=1, description="number of lanes")
    mode: Literal["calm", "dense"] = "calm"
    wet: bool = False
    corners: tuple[Corner, ...] = ()
    limits: dict[str, float] = Field({})
    map: Map | None = None
    size: float | tuple[float, float] = 4.5
    label: str | None = None


class TrackerConfig(Options):
    delay: int = Field(0, ge=0, description="steps of delay")

    @field_validator("delay")
    @classmethod
    def _even(cls, value):
        if value == 13:
            raise ValueError("13 is unlucky")
        if value == 66:
            raise RuntimeError("the validator itself fails")
        return value


class ToyConfig(Options):
    rollouts: int = Field(100, ge=1, description="rollouts per run")
    level: float = 0.1


class RuleConfig(Options):
    rule: Literal["R_G1", "R_G2"]


def _part(kind, name, config, needs=(), **fields):
    factory, summary = "avrare_fake_heavy:build", f"fake {name}"
    return Component(kind, name, f"avrare_fake:{config}", factory, summary, needs, **fields)


@hookimpl
def avrare_components():
    return [
        _part("simulator", "box", "SimulatorConfig"),
        _part("perception", "blind", "TrackerConfig", needs=("no_such_module.inner", "json")),
        _part("tracker", "straight", "TrackerConfig"),
        _part("controller", "coast", "TrackerConfig", warnings={"stuck": "it has not moved"}),
        _part("specification", "book", "RuleConfig"),
        _part("estimator", "toy", "ToyConfig"),
        _part("estimator", "hollow", "NoSuchClass"),
    ]
