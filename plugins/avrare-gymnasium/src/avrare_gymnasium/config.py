"""What a scenario says about a Gymnasium environment. Units are those of the environment."""

from __future__ import annotations

import re
from importlib.metadata import entry_points
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

OUTCOMES = ("reward", "terminated", "truncated")
"""Signals beside the observation's."""
_Size = Annotated[float, Field(ge=0.0)]
Scale = _Size | tuple[_Size, ...]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class StreamConfig(_Model):
    """What the environment's own random numbers are made of."""

    by: Literal["seed", "tape", "none", "free"] = Field(
        default="seed",
        description="seed: its generator is seeded from one number of the noise; tape: the numbers of the "
        "noise themselves are what it draws; none: the same numbers in every rollout; free: nobody seeds it, "
        "so that nothing can be reproduced and only mc can be used",
    )
    at: Literal["reset", "step"] = Field(
        default="step", description="step: at the reset and at every step; reset: only there"
    )
    numbers: int = Field(
        default=4,
        ge=1,
        le=10_000,
        description="tape: of a reset and of a step; what it draws beyond is seeded",
    )


class ChannelConfig(_Model):
    """Noise that is added."""

    law: Literal["normal", "uniform", "laplace"] = Field(default="normal", description="its law")
    scale: Scale = Field(
        description="standard deviation (normal), half width (uniform) or mean size (laplace); one for all "
        "entries, or one for each"
    )


class ActionNoiseConfig(_Model):
    """Noise on the action: added to it, or another action in its place."""

    law: Literal["normal", "uniform", "laplace", "random"] = Field(
        default="normal", description="random: any action of the space, all equally likely"
    )
    scale: Scale | None = Field(default=None, description="as of other noise; not for random")
    probability: float | None = Field(default=None, ge=0.0, le=1.0, description="random: that it takes place")

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.law == "random") != (self.probability is not None) or (self.law == "random") == (
            self.scale is not None
        ):
            raise ValueError("law random takes a probability, every other law a scale")
        return self


class InitialConfig(ChannelConfig):
    """Noise on the state after a reset."""

    attribute: str = Field(
        default="state", pattern=r"[A-Za-z_]\w*", description="of the environment: its state"
    )


class NoiseConfig(_Model):
    """Where noise comes in."""

    stream: StreamConfig = Field(default_factory=StreamConfig, description="its own random numbers")
    action: ActionNoiseConfig | None = Field(default=None, description="on actions")
    observation: ChannelConfig | None = Field(
        default=None, description="on what the controller sees; signals stay true"
    )
    initial: InitialConfig | None = Field(default=None, description="on the state after a reset")


class GymnasiumConfig(_Model):
    """Options of the simulator ``gymnasium``."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"env": "Pendulum-v1", "noise": {"action": {"law": "random", "probability": 1.0}}}]
        }
    )

    env: str = Field(min_length=1, description="id of a registered environment, e.g. CartPole-v1")
    options: dict[str, Any] = Field(default_factory=dict, description="keyword arguments of the environment")
    reset: dict[str, Any] = Field(default_factory=dict, description="options of every reset")
    dt: float = Field(default=1.0, gt=0.0, description="step [s]; formulas in seconds use it")
    signals: dict[str, int] | None = Field(
        default=None,
        description="name -> entry of the flattened observation; without: o0, o1, ...",
    )
    noise: NoiseConfig = Field(default_factory=NoiseConfig, description="where noise comes in")
    copy_by: Literal["replay", "deepcopy", "hook"] = Field(
        default="replay",
        alias="copy",
        description="how a rollout branches from another; hook: the environment's own snapshot and restore",
    )
    step_timeout: float | None = Field(
        default=None, gt=0.0, le=86400.0, description="a reset or step that takes longer [s] is an error"
    )
    reuse: bool = Field(
        default=True, description="reset environments for the next rollout, else make new ones"
    )

    @field_validator("env")
    @classmethod
    def _installed(cls, env: str) -> str:
        module = env.partition(":")[0].partition(".")[0] if ":" in env else None
        if module is not None and module not in _plugin_modules():
            raise ValueError(
                f"{env!r} would run the code of module {module!r}, which is no installed plugin: "
                "register it by an entry point (group gymnasium.envs), and leave the module out"
            )
        return env

    @field_validator("signals")
    @classmethod
    def _good_names(cls, signals: dict[str, int] | None) -> dict[str, int] | None:
        for name, entry in (signals or {}).items():
            if not re.fullmatch(r"[A-Za-z_]\w*", name) or name in OUTCOMES:
                raise ValueError(
                    f"{name!r} cannot name a signal: letters, digits, '_', and none of {OUTCOMES}"
                )
            if entry < 0:
                raise ValueError(f"{name}: entries of the observation count from 0")
        return signals


def _plugin_modules() -> set[str]:
    """Top-level modules that installed distributions offer as plugins."""
    return {
        point.module.partition(".")[0]
        for group in ("gymnasium.envs", "avrare")
        for point in entry_points(group=group)
    }
