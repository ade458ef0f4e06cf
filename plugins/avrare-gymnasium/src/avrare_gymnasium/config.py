"""Options of the simulator ``gymnasium`` and of the controllers. Units are those of the environment."""

from __future__ import annotations

import re
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, field_validator, model_validator

from avrare.plugin import Drawable, Options
from avrare.scenario.fingerprint import is_file

OUTCOMES = ("reward", "terminated", "truncated")
"""Signals in addition to the observation."""
Vector = tuple[float, ...]
_Size = Annotated[float, Field(ge=0.0)]
Scale = _Size | tuple[_Size, ...]


class StreamConfig(Options):
    """Source of the environment's own random numbers."""

    by: Literal["seed", "tape", "none", "free"] = Field(
        default="seed",
        description="seed: a noise number seeds its generator; tape: it draws the noise numbers themselves; "
        "none: the same numbers in every rollout; free: not seeded, so rollouts are not reproducible and "
        "only mc can be used",
    )
    at: Literal["reset", "step"] = Field(
        default="step", description="step: at the reset and at every step; reset: at the reset only"
    )
    numbers: int = Field(
        default=4,
        ge=1,
        le=10_000,
        description="tape: noise numbers per reset and per step; further draws are seeded from them",
    )


class ChannelConfig(Options):
    """Additive noise."""

    law: Literal["normal", "uniform", "laplace"] = Field(default="normal", description="distribution")
    scale: Scale = Field(
        description="standard deviation (normal), half width (uniform) or mean absolute value (laplace); "
        "one for all entries, or one per entry"
    )


class ActionNoiseConfig(Options):
    """Noise on the action: additive, or replacement by a random action."""

    law: Literal["normal", "uniform", "laplace", "random"] = Field(
        default="normal",
        description="distribution; random: replace by a uniformly random action of the space",
    )
    scale: Scale | None = Field(default=None, description="scale of additive noise; not for random")
    probability: float | None = Field(
        default=None, ge=0.0, le=1.0, description="random: probability of a replacement"
    )

    @model_validator(mode="after")
    def _check_law(self) -> Self:
        replaces = self.law == "random"
        if replaces != (self.probability is not None) or replaces == (self.scale is not None):
            raise ValueError("law random requires probability, every other law requires scale")
        return self


class InitialConfig(ChannelConfig):
    """Noise on the state after a reset."""

    attribute: str = Field(
        default="state",
        pattern=r"^[A-Za-z_]\w*$",
        description="attribute of the environment that holds its state",
    )


class NoiseConfig(Options):
    """Noise of the environment, by where it enters."""

    stream: StreamConfig = Field(default_factory=StreamConfig, description="source of its own random numbers")
    action: ActionNoiseConfig | None = Field(default=None, description="noise on actions")
    observation: ChannelConfig | None = Field(
        default=None, description="noise on the controller's observation; signals stay exact"
    )
    initial: InitialConfig | None = Field(default=None, description="noise on the state after a reset")


class GymnasiumConfig(Options):
    """Options of the simulator ``gymnasium``."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"env": "Pendulum-v1", "noise": {"action": {"law": "random", "probability": 1.0}}}]
        }
    )

    env: str = Field(min_length=1, description="id of a registered environment, e.g. CartPole-v1")
    options: dict[str, Any] = Field(default_factory=dict, description="keyword arguments of the environment")
    reset: dict[str, Any] = Field(default_factory=dict, description="options of every reset")
    attributes: dict[str, Drawable] = Field(
        default_factory=dict,
        description="numbers of the environment that are set before every reset, such as gravity: 9.8; what "
        "it computes from them when it is made stays as it was",
    )
    dt: float = Field(default=1.0, gt=0.0, description="time step [s]; converts time bounds of formulas")
    signals: dict[str, int] | None = Field(
        default=None,
        description="name -> entry of the flattened observation; default: o0, o1, ...",
    )
    noise: NoiseConfig = Field(default_factory=NoiseConfig, description="noise, by where it enters")
    copy_by: Literal["replay", "deepcopy", "hook"] = Field(
        default="replay",
        alias="copy",
        description="how the state is copied at a branch; hook: the environment's own snapshot and restore",
    )
    step_timeout: float | None = Field(
        default=None,
        gt=0.0,
        le=86400.0,
        description="limit of the duration of a reset or step [s]; longer ones are rollout errors",
    )
    reuse: bool = Field(
        default=True, description="reset environments for the next rollout instead of creating new ones"
    )

    def used_files(self) -> dict[str, Path]:
        """Files that the keyword arguments of the environment name, by dotted option."""
        blocks = {"options": self.options, "reset": self.reset}
        return {
            f"{option}.{key}": Path(value)
            for option, arguments in blocks.items()
            for key, value in arguments.items()
            if is_file(value)
        }

    @field_validator("env")
    @classmethod
    def _require_installed(cls, env: str) -> str:
        module = env.partition(":")[0].partition(".")[0]
        if ":" in env and module not in _plugin_modules():
            raise ValueError(
                f"{env!r} would run code of module {module!r}, which is not an installed plugin: "
                "register it with an entry point (group gymnasium.envs), and omit the module"
            )
        return env

    @field_validator("attributes")
    @classmethod
    def _public(cls, attributes: dict[str, float]) -> dict[str, float]:
        for name in attributes:
            if not re.fullmatch(r"[A-Za-z]\w*", name):
                raise ValueError(f"{name!r} does not name a public attribute")
        return attributes

    @field_validator("signals")
    @classmethod
    def _check_names(cls, signals: dict[str, int] | None) -> dict[str, int] | None:
        for name, entry in (signals or {}).items():
            if not re.fullmatch(r"[A-Za-z_]\w*", name) or name in OUTCOMES:
                raise ValueError(
                    f"{name!r} is not a valid signal name: use letters, digits, '_', and none of {OUTCOMES}"
                )
            if entry < 0:
                raise ValueError(f"{name}: entries of the observation count from 0")
        return signals


def _plugin_modules() -> set[str]:
    return {
        point.module.partition(".")[0]
        for group in ("gymnasium.envs", "avrare")
        for point in entry_points(group=group)
    }


class FeedbackConfig(Options):
    """Options of the controller ``gym_feedback``: u = offset - gain (observation - reference)."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"gain": [[1.0]]}]})

    gain: tuple[Vector, ...] = Field(
        min_length=1,
        description="matrix (commands x observation); a discrete space takes scores of its actions",
    )
    reference: Vector | None = Field(default=None, description="reference observation (default 0)")
    offset: Vector | None = Field(default=None, description="command at the reference (default 0)")

    @model_validator(mode="after")
    def _check_shapes(self) -> Self:
        width = len(self.gain[0])
        if any(len(row) != width for row in self.gain):
            raise ValueError("the rows of gain have different lengths")
        if self.reference is not None and len(self.reference) != width:
            raise ValueError(f"reference must have {width} numbers, one per column of gain")
        if self.offset is not None and len(self.offset) != len(self.gain):
            raise ValueError(f"offset must have {len(self.gain)} numbers, one per row of gain")
        return self


class ConstantConfig(Options):
    """Options of the controller ``gym_constant``."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"action": 0}]})

    action: int | Vector = Field(description="integer action of a discrete space, or entries of a box")
